"""`python -m benchmarks.outside`: see `judge`."""

from .judge import main

if __name__ == "__main__":
    main()
