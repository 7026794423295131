"""``python -m piezo_rig``."""

import sys

from piezo_rig.cli import main

sys.exit(main())
