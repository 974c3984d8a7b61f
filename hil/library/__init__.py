"""Shipped data: lines, trains and scenarios as TOML; `hil.railway.library` finds them."""
