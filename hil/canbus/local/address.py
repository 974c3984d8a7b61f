"""Local bus, where the hub of a channel is found: one socket file per channel, one hub per lock.

The folder is `$XDG_RUNTIME_DIR/hil`, else `hil-<user>` in the folder of temporary files; it belongs to
the user alone (0700), so users do not meet on a bus. `<channel>.sock` is the hub's socket,
`<channel>.lock` is held by the hub as long as it lives: the kernel releases it however the hub ends, so
what a dead hub left behind is known to be stale. Where there is no AF_UNIX, `<channel>.sock` holds a port
of 127.0.0.1 and a secret.
"""

from __future__ import annotations

import contextlib
import getpass
import os
import re
import secrets
import socket
import stat
import tempfile
from pathlib import Path

HAVE_UNIX_SOCKETS = hasattr(socket, "AF_UNIX")
MAX_SOCKET_PATH = 107 if os.path.exists("/proc") else 103  # bytes in sockaddr_un without the closing zero
_BUFFER_BYTES = 1 << 20  # asked for; the kernel gives what net.core.wmem_max allows
_SECRET_LENGTH = 32
_BACKLOG = 128


class AddressError(ValueError):
    """A channel cannot have a hub: which name or folder, and why, in one line."""


class ChannelTakenError(RuntimeError):
    """The channel has a hub already."""


class NoHubError(ConnectionError):
    """Nobody listens on the channel."""


def check_channel(channel: object) -> str:
    """The channel's name as text; raises AddressError when it cannot be a file name."""
    name = str(channel)
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.:@+-]*", name):
        raise AddressError(
            f"channel {name!r} of the local bus: a name starts with a letter, digit or underscore "
            "and goes on with those or . : @ + -"
        )
    return name


def folder() -> Path:
    """The user's folder of hub sockets, made if missing; raises AddressError when it is somebody else's."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and os.path.isdir(runtime) and os.access(runtime, os.W_OK):
        path = Path(runtime) / "hil"
    else:
        user = str(os.getuid()) if hasattr(os, "getuid") else getpass.getuser()
        path = Path(tempfile.gettempdir()) / f"hil-{user}"
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise AddressError(f"folder {path} of the local bus: {error.strerror}; set XDG_RUNTIME_DIR") from None
    if not stat.S_ISDIR(found.st_mode) or (hasattr(os, "getuid") and found.st_uid != os.getuid()):
        raise AddressError(f"folder {path} of the local bus belongs to somebody else; set XDG_RUNTIME_DIR")
    if HAVE_UNIX_SOCKETS and stat.S_IMODE(found.st_mode) & 0o077:
        path.chmod(0o700)
    return path


def socket_path(channel: str) -> Path:
    """Where the hub of `channel` listens; raises AddressError when the path is too long for a socket."""
    path = folder() / f"{check_channel(channel)}.sock"
    length = len(os.fsencode(path))
    if HAVE_UNIX_SOCKETS and length > MAX_SOCKET_PATH:
        raise AddressError(
            f"socket {path} is {length} bytes long, the limit is {MAX_SOCKET_PATH}: "
            "choose a shorter channel name or set XDG_RUNTIME_DIR to a shorter folder"
        )
    return path


def channels() -> list[str]:
    """The channels that have a hub, sorted."""
    living = []
    for path in sorted(folder().glob("*.sock")):
        channel = path.name.removesuffix(".sock")
        with contextlib.suppress(OSError, ValueError):  # what a dead hub left behind
            connect(channel, 0.2).close()
            living.append(channel)
    return living


def connect(channel: str, timeout_s: float) -> socket.socket:
    """A connection to the hub of `channel`; raises NoHubError when there is none."""
    path = socket_path(channel)
    try:
        if HAVE_UNIX_SOCKETS:
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                sock.settimeout(timeout_s)
                sock.connect(os.fspath(path))
            except BaseException:
                sock.close()
                raise
        else:
            port, _, secret = path.read_text(encoding="ascii").partition(" ")
            sock = socket.create_connection(("127.0.0.1", int(port)), timeout_s)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.sendall(secret.encode("ascii"))
    except (FileNotFoundError, ConnectionRefusedError):
        raise NoHubError(channel) from None
    enlarge_buffers(sock)
    return sock


def enlarge_buffers(sock: socket.socket) -> None:
    """Ask for buffers that hold a burst; the kernel may give less."""
    for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)


class Claim:
    """The right to be the hub of a channel: the lock, and the socket that listens.

    Raises ChannelTakenError when another hub has it, AddressError when the channel cannot have one.
    """

    def __init__(self, channel: str) -> None:
        self.path = socket_path(channel)
        self._lock_path = self.path.with_suffix(".lock")
        self._lock = _lock(self._lock_path)
        self.secret = b""
        try:
            self.listener = self._listen()
        except OSError as error:
            self._unlock()
            raise AddressError(f"socket {self.path} of the local bus: {error.strerror or error}") from None

    def write_pid(self) -> None:
        """Leave the hub's process id in the lock file, for people."""
        os.ftruncate(self._lock, 0)
        os.lseek(self._lock, 0, os.SEEK_SET)
        os.write(self._lock, str(os.getpid()).encode())

    def accept(self) -> socket.socket | None:
        """The next client, without blocking; None when it has gone already or does not know the secret."""
        try:
            sock, _ = self.listener.accept()
        except (BlockingIOError, ConnectionError):
            return None
        if self.secret:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.settimeout(1.0)
            try:
                known = secrets.compare_digest(sock.recv(_SECRET_LENGTH, socket.MSG_WAITALL), self.secret)
            except OSError:
                known = False
            if not known:
                sock.close()
                return None
        sock.setblocking(False)
        enlarge_buffers(sock)
        return sock

    def release(self) -> None:
        """Stop listening and let another hub have the channel."""
        with contextlib.suppress(OSError):
            self.path.unlink()
        self.listener.close()
        self._unlock()

    def _listen(self) -> socket.socket:
        # Under a name of its own first: clients must never find a socket that does not listen yet.
        fresh = self.path.with_suffix(".new")
        fresh.unlink(missing_ok=True)
        if HAVE_UNIX_SOCKETS:
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(os.fspath(fresh))
        else:
            listener = socket.create_server(("127.0.0.1", 0))
            self.secret = secrets.token_hex(_SECRET_LENGTH // 2).encode("ascii")
            fresh.write_text(f"{listener.getsockname()[1]} {self.secret.decode('ascii')}", encoding="ascii")
        listener.listen(_BACKLOG)
        listener.setblocking(False)
        os.replace(fresh, self.path)
        return listener

    def _unlock(self) -> None:
        with contextlib.suppress(OSError):
            self._lock_path.unlink()
        os.close(self._lock)


def _lock(path: Path) -> int:
    """Hold `path` exclusively until the process ends; raises ChannelTakenError when another process does."""
    while True:
        number = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        if not _try_lock(number):
            holder = os.read(number, 20).decode("ascii", "replace")
            os.close(number)
            raise ChannelTakenError(
                f"channel '{path.stem}' has a hub already" + (f" (process {holder})" if holder else "")
            )
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(number), os.stat(path)):
                return number
        os.close(number)  # its last holder removed the file in between


def _try_lock(number: int) -> bool:
    try:
        try:
            import fcntl
        except ImportError:
            import msvcrt

            msvcrt.locking(number, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        else:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
