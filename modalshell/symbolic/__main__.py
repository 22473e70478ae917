"""``python -m modalshell.symbolic``: write the generated kernels anew."""

from modalshell.symbolic.generator import write

if __name__ == "__main__":
    for path in write():
        print(path)
