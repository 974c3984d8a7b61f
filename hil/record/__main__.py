"""`python -m hil.record`: the recorder process."""

import sys

from hil.record.process import main

if __name__ == "__main__":
    sys.exit(main())
