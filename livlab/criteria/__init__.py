"""Claims: a number with its error, held against limits, and the verdict that follows."""

from livlab.criteria.claim import Claim, Criterion
from livlab.criteria.family import FamilyError, InFamily, family_error, holm, sidak
from livlab.criteria.judging import FALSE_ALARM, SIGMAS, VERDICTS, Drawn, Verdict, judge
from livlab.criteria.limits import BOUNDS, GROUPS, Group, Wanted, group_title, wanted
from livlab.criteria.rounding import format_value, format_with_error, round_to_error
from livlab.criteria.table import COLUMNS, FORMER_COLUMNS, read_claims, write_claims

__all__ = [
    "BOUNDS", "COLUMNS", "FALSE_ALARM", "FORMER_COLUMNS", "GROUPS", "SIGMAS", "VERDICTS", "Claim", "Criterion", "Drawn",
    "FamilyError", "Group", "InFamily", "Verdict", "Wanted", "family_error", "format_value", "format_with_error",
    "group_title", "holm", "judge", "read_claims", "round_to_error", "sidak", "wanted",
    "write_claims",
]  # fmt: skip
