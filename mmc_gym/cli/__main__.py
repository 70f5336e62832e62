"""`python -m mmc_gym.cli` is `mmc-gym`."""

from mmc_gym.cli import main

if __name__ == "__main__":
    main()
