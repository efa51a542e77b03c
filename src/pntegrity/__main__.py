"""``python -m pntegrity``: the command line, where the script is not on the path."""

from pntegrity.cli import main

if __name__ == "__main__":
    main()
