"""``python -m modalshell.symbolic``: generate the kernels of ``modalshell/shell/kernels/generated``."""

from modalshell.symbolic.generator import write

if __name__ == "__main__":
    for path in write():
        print(path)
