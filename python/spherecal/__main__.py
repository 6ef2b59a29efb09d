"""``python -m spherecal``: the command ``spherecal``."""

import sys

from ._cli import main

sys.exit(main())
