"""What differences to the papers may come from: written after the numbers, and changes none of them."""

NOTES: dict[str, str] = {
    "R02": (
        "Likely: the surface sees down between the thin stems of low, sparse reed and so falls short "
        "of them, where the authors' surface stood too high over low stands."
    ),
    "R08": (
        "Likely: four areas give a rank correlation of few possible values; the full study has fourteen."
    ),
    "R05": ("Sparse reed is missed far more often here than by the authors; most of it is taken for water."),
    "T06": (
        "Likely: the virtual grove is hard already at 9.8 degrees (20 % unmatched, the thesis has 6 "
        "%), so that there is less room for a jump. At 19 degrees both have about two thirds."
    ),
    "T14": (
        "The interval holds the threshold: with three seeds a fall of one point cannot be told from "
        "none. Two photographs before and after are neither clearly better nor worse."
    ),
    "T15": (
        "Likely cause, tested with study `holes`: the surface stage removes patches below 1 m2 whose "
        "cells differ by more than 0.5 m, which takes two thirds of the spiky crowns. With them kept "
        "the share without height falls from 69 to 1.8 % at 2.7 degrees (20 cm), but from 93 to 89 % "
        "only at 10.7 degrees; only 10 % of the tree cells are then within 0.5 m of the truth, so "
        "that the optimum stays at the smallest angle."
    ),
    "T17": (
        "Likely: pines at 20 cm and 8.7 degrees keep most of their cells empty, and the surface stage "
        "takes small patches away (study `holes`); the wide crowns of beeches lose less. The order of "
        "the thesis needs a conifer surface without such holes."
    ),
    "T18": (
        "The direction at 9 cm agrees. At 20 cm completeness falls here too, because the virtual "
        "stand is full of holes at 10 degrees, where that of Baruth has 4 %; keeping small patches or "
        "taking the wind away does not close them (study `holes`: 89 and 91 % of 93 %)."
    ),
    "T19": (
        "Follows from the holes: where few tops are left (9 cm, 60 %), correctness is a matter of chance."
    ),
    "T23": (
        "The differences are below one point and their intervals hold zero: on these surfaces neither "
        "slope nor aspect matters for the crowns."
    ),
    "O05": (
        "Likely: the virtual clearing is photographed at a few centimetres under a low sun with hard "
        "shadows; see docs/reproducibility.md."
    ),
    "O08": (
        "Nearly all forest of this scene differs between repetitions (94 to 99 %), so that gaps "
        "cannot stand out."
    ),
    "collapse": (
        "The published table collapses, our flights do not. Ground resolutions leave the line at "
        "small disparities (below 0.5 px per metre), where two thirds of the virtual crowns stay "
        "empty whatever the flight. Study `holes` shows why: small patches that the surface stage "
        "removes. With them kept 1.8 % are empty at 2.7 degrees and 20 cm."
    ),
    "T11": (
        "Not explained. The scene is small and stands on one side of the strip, and two seeds see few "
        "photographs at 60 %: the full study with six seeds must tell whether the sun or the geometry "
        "makes the difference."
    ),
}
"""Number of a finding (or ``collapse``) -> a sentence or two."""
