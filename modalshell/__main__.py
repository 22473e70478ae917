"""``python -m modalshell``."""

from modalshell.commands.cli import main

if __name__ == "__main__":
    main()
