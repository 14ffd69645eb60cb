"""`python -m tests.helpers.trusted_values [PATTERN]`, in the root of the checkout: compute values anew, store them."""

import sys

from livlab.errors import LivlabError

from .table import main

try:
    sys.exit(main(*sys.argv[1:2]))
except LivlabError as trouble:
    sys.exit(str(trouble))
