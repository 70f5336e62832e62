"""Compiled code that is loaded from disk is the code that was compiled."""

from tests.processes import run_python

LAST_FIELDS = """
import sys
import numpy as np
from mmc_gym._compiling import compiled, shared

@shared
def last_field(row):
    total = 0.0  # enough of a loop that it is called, not inlined
    for i in range(row.first.shape[0]):
        for j in range(row.first.shape[0]):
            total += np.sin(row.first[i]) * np.cos(row.first[j])
            if total > 10.0:
                total -= np.exp(row.first[j])
    row.first[0] = total
    return row.last + 0.0 * total

@compiled
def sum_of_last_fields(rows):
    return last_field(rows[0]) + last_field(rows[1]) + last_field(rows[2])

for length in map(int, sys.argv[1:]):
    rows = np.zeros(3, [("first", np.float64, (length,)), ("last", np.float64)])
    rows["last"] = length
    print(sum_of_last_fields(rows))
"""


def test_two_processes_compile_for_different_records_and_a_third_loads_both(tmp_path):
    program = tmp_path / "last_fields.py"
    program.write_text(LAST_FIELDS)
    assert [run_python(program, length).strip() for length in (3, 5)] == ["9.0", "15.0"]
    assert run_python(program, 3, 5).split() == ["9.0", "15.0"]
