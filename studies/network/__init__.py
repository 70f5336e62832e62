"""What the network does beyond reaching; how its normalizers are trained, and at what cost."""
