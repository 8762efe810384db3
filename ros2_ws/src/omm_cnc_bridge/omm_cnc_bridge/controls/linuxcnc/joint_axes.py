"""Which of LinuxCNC's joints moves which of its axes."""

from __future__ import annotations

from collections.abc import Sequence

from omm_core.errors import DeviceError


def joint_axes(
    given: Sequence[str], letters: str, joints: int
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Return the name of each joint's axis, and which of them are further drives of another.

    A gantry has two joints of one letter (coordinates=XYYZ). The second becomes Y2 and follows Y,
    whether the letters or the parameter linuxcnc_joints say so.

    Raises
    ------
    DeviceError
        Where there are not as many names as joints.
    """
    told = tuple(given or letters)
    if len(told) != joints:
        raise DeviceError(
            f"Expected a name for each of {joints} joints, got {', '.join(told) or 'none'}. List "
            f"{joints} axes in the parameter linuxcnc_joints, in the order of the joints; the "
            "second drive of a gantry may bear its axis's name again: [X, Y, Y, Z]."
        )
    names: list[str] = []
    for name in told:
        count, numbered = 1, name
        while numbered in names:
            count += 1
            numbered = f"{name}{count}"
        names.append(numbered)
    # Where names were given, the configuration still knows which joints are one axis.
    by = tuple(letters) if given and len(set(told)) == joints == len(letters) else told
    followers = {
        names[i]: names[by.index(letter)] for i, letter in enumerate(by) if by.index(letter) < i
    }
    return tuple(names), followers
