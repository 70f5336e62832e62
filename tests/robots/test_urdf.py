"""What a URDF may have between base and tip."""

import pytest

from mmc_gym import HingeArm, UserError

pytest.importorskip("yourdfpy", reason='it takes the extra "urdf"')
XACRO = """<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="a"/>
  {}
</robot>"""


@pytest.mark.parametrize(
    "line",
    [
        '<xacro:include filename="$(find arm)/arm.xacro"/>',
        '<joint name="one" type="fixed"><xacro:insert_block name="origin"/></joint>',
        '<joint name="one" type="fixed"><origin rpy="0 0 ${pi / 2}"/></joint>',
    ],
)
def test_a_file_of_macros_is_refused_with_the_command_that_expands_it(line, tmp_path):
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(XACRO.format(line))
    with pytest.raises(UserError, match=r"it is xacro, as line 3 shows: .* xacro \S+ > robot.urdf"):
        HingeArm.from_urdf(path, base="a", tip="b")
