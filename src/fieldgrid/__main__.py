"""`python -m fieldgrid`, where the script `fieldgrid` is not on the path."""

from fieldgrid.cli import main

if __name__ == "__main__":
    main()
