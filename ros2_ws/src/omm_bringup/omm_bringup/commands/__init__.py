"""One module per command, each with `add_arguments(parser)` and `run(args) -> exit status`.

What is heavy is imported inside `run`, so that `--help` and bad usage answer at once.
"""
