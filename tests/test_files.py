"""A file is written whole or not at all."""

import errno
import os
import subprocess
import sys
from unittest.mock import Mock

import pytest

from mmc_gym._cells import list_differences
from mmc_gym._files import read_yaml, write_atomically

# Writes again and again, and is killed in the middle of it.
SCRIPT = """
import os, sys
from mmc_gym import _files
def killed(number):
    print("writing", flush=True)
    sys.stdin.read()
os.fsync = killed
_files.write_atomically(sys.argv[1], b"new")
"""


def start_writing(path):
    command = [sys.executable, "-c", SCRIPT, str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "writing\n"
    return process


def test_a_killed_writer_leaves_the_old_content(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    write_atomically(path, b"old")
    with start_writing(path) as process:
        process.kill()
    assert path.read_bytes() == b"old"


@pytest.mark.skipif(os.name != "posix", reason="knows no umask")
@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600)])
def test_a_file_has_the_mode_that_the_umask_gives(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        assert write_atomically(tmp_path / "file", b"").stat().st_mode & 0o777 == mode
    finally:
        os.umask(before)


def test_two_writers_of_one_file_leave_each_other_alone(tmp_path):
    path = tmp_path / "result.json"
    with start_writing(path) as process:
        write_atomically(path, b"old")
        process.communicate("continue")
    assert process.returncode == 0
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_leaves_nothing_and_a_full_disk_names_it(
    tmp_path, monkeypatch
):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError):
        write_atomically(tmp_path / "folder", b"new")
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(os, "fsync", Mock(side_effect=full))
    with pytest.raises(OSError, match=r"No space left on device: '.*result'$"):
        write_atomically(tmp_path / "result", b"new")
    assert list(tmp_path.iterdir()) == [tmp_path / "folder"]


def test_yaml_may_override_what_it_merges_and_has_an_end():
    assert read_yaml("{a: &a {x: 1}, b: {<<: *a, x: 2}}") == {"a": {"x": 1}, "b": {"x": 2}}
    with pytest.raises(ValueError, match="it is nested too deeply"):
        read_yaml("[" * 500)


def test_differences_of_settings_are_named_down_to_the_entry():
    first = {"blocks": [{"trials": 2, "rest": 0.0}], "seed": 0, "noise": [{"name": "a"}]}
    second = {"blocks": [{"trials": 3, "rest": 0.0}, {"trials": 1}], "seed": 0}
    assert list(list_differences(first, second)) == [
        "blocks.0.trials 2 and 3",
        "blocks.1 None and {'trials': 1}",
        "noise [{'name': 'a'}] and None",
    ]
    assert not [*list_differences(first, first)]
