"""Learned policies: hyperparameters, training with checkpoints, tuning, learning curves."""
