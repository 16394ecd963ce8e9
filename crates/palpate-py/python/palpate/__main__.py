"""The command `palpate`, identical to the program built without Python."""

import signal
import sys

from . import _palpate


def main() -> None:
    """Runs the command with the arguments of this process, and exits with its exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the command handles Ctrl-C itself
    # A child process must not import modules from the working directory.
    safely = ["-P"] if sys.version_info >= (3, 11) else []
    sys.exit(_palpate.command(["palpate", *sys.argv[1:]], [sys.executable, *safely, "-m", "palpate"]))


if __name__ == "__main__":
    main()
