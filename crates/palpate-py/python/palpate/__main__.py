"""The command `palpate`, the same as the program that is built without Python."""

import signal
import sys

from . import _palpate


def main() -> None:
    """Runs the command with the arguments of this process, and ends it with the command's exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the command listens to Ctrl-C itself
    sys.exit(_palpate.command(["palpate", *sys.argv[1:]], [sys.executable, "-m", "palpate"]))


if __name__ == "__main__":
    main()
