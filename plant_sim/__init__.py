"""The plant: train, drives, brakes, odometry and protection as one node on the bus."""
