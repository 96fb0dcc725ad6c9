"""`python -m flexarm_env.certify`."""

import sys

from flexarm_env.certify.run import main

sys.exit(main())
