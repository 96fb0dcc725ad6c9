"""`python -m flexarm_env.certify`."""

import sys

from dynamics.command import completed
from flexarm_env.certify.run import main

sys.exit(completed("flexarm_env.certify", main))
