"""``python -m piezo_rig``."""

from piezo_rig.cli import program

if __name__ == "__main__":
    program()
