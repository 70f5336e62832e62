"""Draw the film at the top of README: four agents whose second joint locks on the way.

python docs/draw_film.py [docs/film.gif]
"""

import sys
from pathlib import Path

from mmc_gym.record import record

AGENTS = ("mmc", "mmc-body", "ppo", "ppo-drawn")
SEED = 7  # of 33 episodes they reach in 3, 23, 16 and 18; here in 0, 2, 1 and 1 of 2

if __name__ == "__main__":
    default = Path(__file__).resolve().parent / "film.gif"
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    print(f"wrote {record(out, AGENTS, 'locks-2', episodes=2, seed=SEED, every=4)}")
