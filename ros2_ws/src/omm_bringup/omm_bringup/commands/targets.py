"""`./omm targets`: a printable sheet of coded targets, ends of scale bars, or plain targets."""

from __future__ import annotations

import argparse

from omm_core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--family", help="aicon12, aicon14, metashape12, … of coded targets")
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--ids", nargs="+", help="numbers and ranges, such as 1-10,15")
    which.add_argument(
        "--count", type=int, help="propose that many that are hardest to mistake for each other"
    )
    which.add_argument("--plain", type=int, metavar="N", help="N plain dots instead, no numbers")
    parser.add_argument(
        "--bar-ends", action="store_true", help="each two numbers are the ends of a scale bar"
    )
    parser.add_argument("--dot-mm", type=float, required=True, help="diameter of the dot")
    parser.add_argument("--paper", default="A4", help="A5 … A0, letter, legal, tabloid")
    parser.add_argument(
        "--invert", action="store_true", help="black on white; without it white on black"
    )
    parser.add_argument("--out", default="targets.pdf", metavar="PDF")


def run(args: argparse.Namespace) -> int:
    """Write the PDF and say what is on it."""
    if args.plain is None and args.family is None:
        raise InputError("Expected --family of coded targets, or --plain N, got neither.")
    if args.plain is not None and (args.family is not None or args.bar_ends):
        raise InputError("--plain: plain targets have no numbers: neither --family nor --bar-ends.")
    return _coded(args) if args.plain is None else _plain(args)


def _plain(args: argparse.Namespace) -> int:
    from omm_core.targets.plain.printing import PlainSheet, write_pdf

    sheet = PlainSheet(
        count=args.plain, dot_mm=args.dot_mm, paper=args.paper, white_on_black=not args.invert
    )
    _say(args, f"{sheet.count} plain targets", write_pdf(sheet, args.out))
    return 0


def _coded(args: argparse.Namespace) -> int:
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
        family=family, ids=proposal.ids, dot_mm=args.dot_mm, paper=args.paper,
        white_on_black=not args.invert, bar_ends=args.bar_ends,
    )  # fmt: skip
    _say(args, f"{len(proposal.ids)} targets", write_pdf(sheet, args.out))
    print(f"Numbers: {', '.join(map(str, proposal.ids))}")
    if len(proposal.ids) > 1:
        print(f"Why these: {proposal.why()}." if args.count else f"These: {proposal.why()}.")
    if sheet.bars:
        print("Have each bar's length between the dots' centres measured; then, in survey.yaml:")
        print("scale_bars:")
        for first, second in sheet.bars:
            print(f"- {{ends: [{first}, {second}], length_mm: ..., sigma_mm: ...}}")
    return 0


def _say(args: argparse.Namespace, what: str, pages: int) -> None:
    print(
        f"{args.out}: {what} on {pages} page{'s' if pages > 1 else ''} {args.paper}. Print at 100 %"
        " and measure the scale bar."
    )
