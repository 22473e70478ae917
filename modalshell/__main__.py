"""``python -m modalshell``."""

from modalshell.cli import main

if __name__ == "__main__":
    main()
