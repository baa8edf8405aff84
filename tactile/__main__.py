"""``python -m tactile`` is the command ``tactile``."""

from tactile.cli import main

if __name__ == "__main__":
    main()
