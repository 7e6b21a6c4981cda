"""`python -m nacre` is the same as the command `nacre`."""

from nacre.cli import main

if __name__ == "__main__":
    main()
