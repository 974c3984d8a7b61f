"""The ATO unit: follows a speed profile over the CAN bus, under one control law and its supervision."""
