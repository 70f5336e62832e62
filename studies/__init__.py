"""Science done with mmc_gym, run from a clone: see README.md."""
