"""What differences to the papers may come from: written after the numbers, and changes none of them."""

NOTES: dict[str, str] = {
    "R02": (
        "Likely: the surface sees down between the thin stems of low, sparse reed and so falls short of "
        "them, where the authors' surface stood too high over low stands."
    ),
    "R05": ("Sparse reed is missed far more often here than by the authors; most of it is taken for water."),
    "R06": (
        "Likely chance: four areas of 40 m have few sections, and the two seeds differ in which kind is "
        "found better; overall accuracy is that of the paper."
    ),
    "R08": (
        "Likely chance: four areas give a rank correlation of few possible values, and its mean lies on "
        "the threshold; the full study has fourteen."
    ),
    "R10": (
        "One seed and three cuts on four areas: the best cut is the same at 7, 14 and 21 cm. Too coarse "
        "to tell; the full study has fourteen areas and four cuts."
    ),
    "T02": (
        "The order of the 12 cells agrees, the levels do not: 42 % of the virtual area is unmatched at 15 "
        "cm and 80 %, where the table has 0.7 %."
    ),
    "T03": (
        "At 60 % the difference of 9 and 15 cm is half a point and its interval wide: 82 % of the area are "
        "unmatched at either. At the other overlaps the order is clear."
    ),
    "T04": (
        "Saturation: at 9 cm the share is 68 % at 5.6 degrees already, so that it can rise little more, "
        "and 15 and 20 cm catch up. The published shares end where ours begin."
    ),
    "T06": (
        "Two seeds that differ: 6 and 12 % in trees at 9.8 degrees (the thesis has 6 %), 68 and 60 % at "
        "19.6 degrees (64 %)."
    ),
    "T07": ("One seed, just below the threshold; the jump of T06 is that of two seeds."),
    "T10": (
        "Not even in the middle of the image: 39 % of the trees unmatched with 210 mm at 5.6 degrees, 25 % "
        "with 80 mm at 9.7. Likely: at 70 % overlap a place is seen by two pairs, at 80 % by four, and a "
        "cell counts as matched if one of them succeeds; where many matches fail that outweighs the angle. "
        "In blocks of three strips, where more pairs see a place, the difference shrinks (12 and 7 %). One "
        "seed. Not tested with equal numbers of pairs."
    ),
    "T11": (
        "In trees the directions differ by 0.5 to 4 points; the rest comes from the ground between and "
        "beside them. Likely: the stand lies on one side of a scene of 48 m, so that the strip along its "
        "border and the one across it see other parts of the ground. Not tested."
    ),
    "T12": (
        "Coarser matching leaves less at every flight, as published. The gain is greater at 80 than at 60 "
        "% because at 19 degrees 59 % of the trees stay unmatched even at downscale 3 (thesis: 5 %)."
    ),
    "T14": (
        "A second photograph leaves 2 points of the area and 5 of the trees less unmatched. Likely as in "
        "T10: 49 to 64 % of the trees are unmatched with one, so that further pairs, though at twice the "
        "angle, still add some."
    ),
    "T15": (
        "Two parts. Unmatched shares rise so fast with the angle that the smallest wins; and of the porous "
        "cells that are matched few are within 0.5 m of their mean height (10 to 14 % of all at 2.7 "
        "degrees), so that losing height accuracy at small angles hardly counts. Tested with study "
        "`holes`: without wind, small segments and small patches removed 74 % stay unmatched at 10.8 "
        "degrees (86 as flown, 20 cm), so none of them is the cause. What is left is the foliage itself: "
        "particles without the larger structure that twigs and branches give to a real crown. Crowns were "
        "made nearly twice as dense before these tables (leaf area 4.5 and 5 as in real stands); that "
        "lowered the unmatched share at 20 cm and 80 % from 37 to 28 %, and did not move the optimum."
    ),
    "T17": (
        "Conifers are found more completely than old beeches and less than young ones (79, 68 and 84 %). "
        "Correctness is lower than published in all stands: on photographed surfaces many false tops stand "
        "on branches of the same crown, most of them in old beeches (27 % correct)."
    ),
    "T18": (
        "The direction at 9 cm agrees. At 20 cm completeness falls here too, because at 10.8 degrees 87 % "
        "of the crowns are unmatched, in Baruth 4 % of the area."
    ),
    "T19": (
        "Correctness lies at 45 to 65 % rather than 99 %, and where few tops are left (9 cm from 70 % on) "
        "it is a matter of chance."
    ),
    "T20": (
        "The collapse agrees (nothing is found). Downscale 2 does not help here: 99 % of the trees stay "
        "unmatched at 19 degrees. Tested at 10.9 degrees with `tops-direction`: there downscale 1 finds 0 "
        "to 1 %, downscale 2 42 to 54 %, downscale 3 63 to 84 %, as the thesis says of 19 degrees."
    ),
    "T21": (
        "Conifers lose as stated (33 points). Old broadleaf has so many false tops with either set "
        "(correctness 27 and 18 %) that 10 points are hardly to be lost; the order is as stated."
    ),
    "T23": (
        "The difference of the slope is nil, those of the aspect are below four points and their intervals "
        "hold zero: on these surfaces neither matters for the crowns."
    ),
    "T24": (
        "Old stand as stated. The young one has nine free-standing trees, and its two seeds differ: chance."
    ),
    "T25": (
        "With downscale 1 at 19 degrees no top is found in measured cells either, so that there is nothing "
        "to compare with."
    ),
    "O01": (
        "The best threshold is at the end of the tried ones: of the virtual lake no tie points are so "
        "wrong that filtering them decides, nor are there so few that strict filtering starves the block."
    ),
    "O02": (
        "Control and recorded positions hold the block to centimetres before any filtering (about 3 m in "
        "the paper): nothing is left to gain by a factor of ten."
    ),
    "O05": (
        "At 15 cm, ten repetitions. The forest is near the paper. Likely what differs in the meadow are "
        "cells whose photograph changes with the seam. Not tested."
    ),
    "O10": (
        "What is compared here is less the light than how far random choices lead: in low sun ten seeds "
        "end in the same poses (check points within 0.01 mm), under the overcast sky they scatter by 6 mm "
        "in height. With five repetitions at 8 cm the forest was alike in both lights "
        "(docs/reproducibility.md)."
    ),
    "O07": (
        "In low sun ten seeds lead to poses within hundredths of a millimetre of one another, so that the "
        "first five find all there is. Under an overcast sky, where they scatter by millimetres, the index "
        "is 0.93."
    ),
    "collapse": (
        "Both collapse: the virtual line is as steep as the published one, with the same scatter. Its "
        "level differs: the virtual stand reaches the same unmatched share at a fraction of the disparity. "
        "It breaks at 30 cm, above the line by half a logit."
    ),
}
"""Number of a finding (or ``collapse``) -> a sentence or two."""
