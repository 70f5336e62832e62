"""Run the paper's experiments; write figures, data, and a table with the published values.

make paper                                  # all of them
python -m studies.paper [EXPERIMENT ...] [--quick] [--out OUT] [--seed SEED] [--jobs JOBS]
"""

import tyro

from studies.paper.run import reproduce

if __name__ == "__main__":
    tyro.cli(reproduce, prog="python -m studies.paper")
