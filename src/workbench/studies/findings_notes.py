"""What differences to the papers may come from: written after the numbers, and changes none of them."""

NOTES: dict[str, str] = {
    "R02": (
        "Likely: the virtual belts hold no low, sparse stands whose stems carry the surface above the field "
        "height; the photographs look down between thin stems, so that low stands are underestimated."
    ),
    "R08": "Likely: four areas give a rank correlation of few possible values; the full study has 14.",
    "T06": (
        "Likely: the virtual grove is hard already at 9.8 degrees (20 % unmatched, the thesis has 6 %): there "
        "is less room for a jump. At 19 degrees both have about two thirds."
    ),
    "T14": (
        "The interval holds the threshold: with three seeds a fall of one point cannot be told from none. The "
        "share with two photographs before and after is neither clearly better nor worse."
    ),
    "T15": (
        "Likely: two thirds of the virtual conifers stay empty at every angle (see study `holes`), and what is "
        "left is ruled by lost matches alone; lost accuracy at 2.65 degrees does not show beside them."
    ),
    "T18": (
        "The direction at 9 cm agrees. At 20 cm completeness falls here as well, because the surface of the "
        "virtual stand is already full of holes at 10 degrees, where that of Baruth has 4 %."
    ),
    "T19": "Follows from the holes: where few trees are left (9 cm, 60 %), correctness is a matter of chance.",
    "O05": (
        "Likely: the virtual clearing is photographed at a few centimetres in low sun and hard shadow, and its "
        "meadow has finer texture than a grazed one; see docs/reproducibility.md."
    ),
    "O08": (
        "The whole forest is hardly reproducible in this scene (95 % differ), so that gaps cannot stand out."
    ),
    "collapse": (
        "The published table collapses, our flights do not: ground resolutions bend away from the line at small "
        "disparities (below 0.5 px per metre), where a share of about two thirds of the virtual crowns stays "
        "empty whatever the flight. There the loss does not come from disparity."
    ),
}
"""Number of a finding (or ``collapse``) -> a sentence or two."""
