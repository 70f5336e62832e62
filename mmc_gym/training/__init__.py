"""Learned policies: hyperparameters, training with checkpoints, what stable-baselines3 needs."""
