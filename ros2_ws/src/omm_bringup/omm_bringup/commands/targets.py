"""`./omm targets`: a printable sheet of coded targets."""

from __future__ import annotations

import argparse

from omm_core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--family", required=True, help="aicon12, aicon14, metashape12, …")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--ids", nargs="+", help="numbers and ranges, such as 1-10,15")
    which.add_argument(
        "--count", type=int, help="propose that many that are hardest to mistake for each other"
    )
    parser.add_argument("--dot-mm", type=float, required=True, help="diameter of the dot")
    parser.add_argument("--paper", default="A4", help="A5 … A0, letter, legal, tabloid")
    parser.add_argument(
        "--invert", action="store_true", help="black on white; without it white on black"
    )
    parser.add_argument("--out", default="targets.pdf", metavar="PDF")


def run(args: argparse.Namespace) -> int:
    """Write the PDF and say how far apart its numbers are."""
    from omm_core.targets import TargetFamily
    from omm_core.targets.coded.choosing import propose_ids, separation
    from omm_core.targets.coded.printing import Sheet, parse_ids, write_pdf

    family = TargetFamily.by_name(args.family)
    if args.count is not None:
        proposal = propose_ids(family, args.count)
    else:
        ids = parse_ids(args.ids)
        if not ids:
            raise InputError("--ids: expected numbers such as 1-10,15, got none.")
        proposal = separation(family, ids)
    sheet = Sheet(
        family=family,
        ids=proposal.ids,
        dot_mm=args.dot_mm,
        paper=args.paper,
        white_on_black=not args.invert,
    )
    pages = write_pdf(sheet, args.out)
    print(
        f"{args.out}: {len(proposal.ids)} targets on {pages} page{'s' if pages > 1 else ''} "
        f"{args.paper}. Print at 100 % and measure the scale bar."
    )
    print(f"Numbers: {', '.join(map(str, proposal.ids))}")
    if len(proposal.ids) > 1:
        print(f"Why these: {proposal.why()}." if args.count else f"These: {proposal.why()}.")
    return 0
