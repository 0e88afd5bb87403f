"""``python -m flows.server``: `prefect server start` behind a door."""

import sys

from flows.server.process import main

if __name__ == "__main__":
    sys.exit(main())
