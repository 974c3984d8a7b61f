"""What a bus can carry, computed: worst-case response times from the DBC, and the load that was measured."""
