"""What differences to the papers may come from: written after the numbers, and changes none of them."""

NOTES: dict[str, str] = {}
"""Number of a finding (or ``collapse``) -> a sentence or two."""
