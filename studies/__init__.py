"""Reproductions of published papers: one module per paper, its numbers beside this program's."""
