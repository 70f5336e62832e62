"""Learned policies: hyperparameters, training with checkpoints, grids, tuning, learning curves."""
