"""The default engine: the arm as rigid bodies in pymunk."""
