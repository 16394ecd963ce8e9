"""The command `palpate`, the same as the program that is built without Python."""

import signal
import sys

from . import _palpate


def main() -> None:
    """Runs the command with the arguments of this process, and ends it with the command's exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the command listens to Ctrl-C itself
    # Started again, it takes no module from the folder in which it happens to run.
    safely = ["-P"] if sys.version_info >= (3, 11) else []
    sys.exit(_palpate.command(["palpate", *sys.argv[1:]], [sys.executable, *safely, "-m", "palpate"]))


if __name__ == "__main__":
    main()
