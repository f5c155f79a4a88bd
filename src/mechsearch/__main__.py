"""`python -m mechsearch`."""

from mechsearch.cli import main

if __name__ == "__main__":
    main()
