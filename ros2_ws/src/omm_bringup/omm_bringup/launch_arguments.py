"""Arguments of launch files, checked by name: `ros2 launch` itself takes any."""

from collections.abc import Iterable

from omm_core.errors import InputError, did_you_mean

# What launch sets itself.
_OF_LAUNCH = ("launch_file_path", "ros_", "params", "log_", "current_launch_file", "output_")


def check_names(known: Iterable[str], given: Iterable[str]) -> None:
    """Refuse an argument that the launch file does not declare.

    Raises
    ------
    InputError
        One is unknown; the nearest one is told.
    """
    names = sorted(known)
    for name in given:
        if name in names or name.startswith(_OF_LAUNCH):
            continue
        raise InputError(
            f"Launch argument {name}: expected one of {', '.join(names)}."
            f"{did_you_mean(name, names)} (--show-args describes them.)"
        )


def check_choice(name: str, given: str, choices: Iterable[str]) -> None:
    """Refuse a value that is none of the choices.

    Raises
    ------
    InputError
        It is not.
    """
    if given not in choices:
        there = ", ".join(choices)
        raise InputError(f"Launch argument {name}: expected one of {there}; got {given!r}.")


def check_whole_number(name: str, given: str) -> int:
    """Return the number that an argument gives.

    Raises
    ------
    InputError
        It is not a whole number, or is negative.
    """
    if not (given.isascii() and given.isdigit()):
        raise InputError(f"Launch argument {name}: expected a whole number, got {given!r}.")
    return int(given)


def check_switch(name: str, given: str) -> bool:
    """Return whether an argument says yes.

    Raises
    ------
    InputError
        It says neither yes nor no.
    """
    check_choice(name, given.lower(), ("true", "false"))
    return given.lower() == "true"
