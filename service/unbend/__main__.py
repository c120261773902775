"""`python -m unbend` is the command line."""

from unbend.cli import main

if __name__ == "__main__":
    main()
