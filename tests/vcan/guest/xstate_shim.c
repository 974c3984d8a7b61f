// LD_PRELOAD shim for user-mode Linux on processors with AMX: its kernel keeps a small buffer for the extended
// register state, the host has more (11008 bytes), and PTRACE_SETREGSET refuses the short one. The short state is merged
// into the full one. Needed only where /proc/cpuinfo names amx_tile.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>
#include <sys/types.h>
#include <unistd.h>
#include <sys/syscall.h>
#include <stdlib.h>
#include <stdio.h>
#include <errno.h>
#define NT_X86_XSTATE 0x202
static char full[65536] __attribute__((aligned(64)));
static long raw(long r,long p,void*a,void*d){ return syscall(SYS_ptrace,r,p,a,d); }
long ptrace(enum __ptrace_request req, ...){
  va_list ap; va_start(ap,req); pid_t pid=va_arg(ap,pid_t); void*addr=va_arg(ap,void*); void*data=va_arg(ap,void*); va_end(ap);
  long r=(long)req;
  if(r==PTRACE_PEEKTEXT||r==PTRACE_PEEKDATA||r==PTRACE_PEEKUSER){ long v; long rc=raw(r,pid,addr,&v); return rc<0?rc:v; }
  if(r==PTRACE_SETREGSET && (long)addr==NT_X86_XSTATE){
    struct iovec*u=data; struct iovec f={full,sizeof full};
    if(raw(PTRACE_GETREGSET,pid,addr,&f)<0) return -1;
    if(f.iov_len>u->iov_len){
      size_t L=u->iov_len; memcpy(full,u->iov_base,L);
      uint64_t bv; memcpy(&bv,full+512,8);
      if(L<=2816) bv&=~((1ULL<<17)|(1ULL<<18));   // AMX tile cfg/data live beyond
      if(L<2696)  bv&=~(1ULL<<9);                 // PKRU
      memcpy(full+512,&bv,8);
      struct iovec s={full,f.iov_len};
      long rc=raw(PTRACE_SETREGSET,pid,addr,&s);
      if(rc<0 && getenv("SHIM_DBG")) fprintf(stderr,"shim: set len %zu full %zu errno %d\n",L,(size_t)f.iov_len,errno);
      return rc;
    }
    return raw(r,pid,addr,data);
  }
  return raw(r,pid,addr,data);
}
