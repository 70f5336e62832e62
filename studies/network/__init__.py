"""What the network does beyond reaching, and what its normalizers cost to train."""
