"""The bus: what the DBC says (contract, protection) and what carries it (transport, local)."""
