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
        "The order of the 12 cells agrees, the levels do not: half of the virtual stand is unmatched at "
        "15 cm and 80 %, where the table has 0.7 %."
    ),
    "T03": (
        "It fails at 60 % alone, where 72 to 84 % of the scene are unmatched at every resolution: nothing "
        "is left to tell 9 from 15 cm. At 90, 80 and 70 % the order holds."
    ),
    "T04": (
        "Saturation: at 9 cm the share is 72 % at 5.5 degrees already, so that it can rise no more, and "
        "15 and 20 cm catch up. The published shares end where ours begin."
    ),
    "T06": (
        "Barely, and with two seeds that differ (12 and 21 % in trees at 9.8 degrees): the thesis has 6 "
        "%. At 19 degrees 80 % are unmatched, there 64 %."
    ),
    "T07": ("One seed, just above the threshold; the jump of T06 is that of two seeds."),
    "T10": (
        "Not even in the middle of the image: 49 % of the trees unmatched with 210 mm at 5.6 degrees, 39 "
        "% with 80 mm at 9.8. Likely: at 70 % overlap a place is seen by two pairs, at 80 % by four, and "
        "a cell counts as matched if one of them succeeds; where half of all matches fail that outweighs "
        "the angle. The two seeds differ widely. Not tested."
    ),
    "T11": (
        "In trees alone the directions differ by 0.7 to 2.6 points; the rest comes from the ground "
        "between and beside them. Likely: the stand lies on one side of a scene of 48 m, so that the "
        "strip along its border and the one across it see other parts of the ground. Not tested."
    ),
    "T12": (
        "Coarser matching leaves less at every flight, as published. The gain is greater at 80 than at 60 "
        "% because at 19 degrees three quarters of the trees stay unmatched even at downscale 3 (thesis: "
        "5 %): there is no more to gain where nothing matches."
    ),
    "T14": (
        "The means fall by 1.0 and 1.9 points and their intervals hold zero: two seeds cannot tell a fall "
        "of one point from none."
    ),
    "T15": (
        "Two parts. Unmatched shares rise so fast with the angle that the smallest wins; and of the "
        "porous cells that are matched few are within 0.5 m of their mean height (9 % at 2.7 degrees), so "
        "that losing height accuracy at small angles hardly counts. Tested with study `holes`: without "
        "wind, small segments and small patches removed 79 % stay unmatched at 10.9 degrees (91 as flown, "
        "20 cm). What is left is the foliage itself: particles without the larger structure that twigs "
        "and branches give to a real crown."
    ),
    "T17": (
        "Conifers are found less completely than beeches because fewer of their cells are matched (T15), "
        "and correctness is low in all stands: on photographed surfaces most false tops stand on branches "
        "of the same crown. Crowns of broadleaf trees, far wider, lose less."
    ),
    "T18": (
        "The direction at 9 cm agrees. At 20 cm completeness falls here too, because at 10.5 degrees 92 % "
        "of the crowns are unmatched, in Baruth 4 % of the area."
    ),
    "T19": (
        "Correctness is about 50 % at every overlap rather than 99 %, and where few tops are left (9 cm "
        "from 80 % on, 15 cm at 60 %) it is a matter of chance."
    ),
    "T20": (
        "The collapse agrees (nothing is found). Downscale 2 does not help here: 99.7 % of the trees stay "
        "unmatched. Downscale 3 would be the better test: `tops-direction` has 84 and 66 % completeness "
        "with it where downscale 1 finds nothing, at 10.9 degrees."
    ),
    "T21": (
        "Conifers lose as stated. Old broadleaf has so many false tops with either set (correctness 26 "
        "and 18 %) that 10 points are not to be lost; with the order as stated."
    ),
    "T23": (
        "The differences are below two points and their intervals hold zero: on these surfaces neither "
        "slope nor aspect matters for the crowns."
    ),
    "T24": (
        "Old stand as stated. The young one has nine free-standing trees, one of which is missed: chance."
    ),
    "T25": (
        "With downscale 1 at 19 degrees nothing is measured in the trees, so that there is nothing to "
        "compare with."
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
        "Likely: the virtual clearing is photographed at a few centimetres under a low sun with hard "
        "shadows; see docs/reproducibility.md. At 15 cm (quick preset, three repetitions) 82 % of the "
        "meadow and 16 % of the forest are reproducible."
    ),
    "O08": (
        "Nearly all forest of this scene differs between repetitions (94 to 99 %), so that gaps cannot "
        "stand out."
    ),
    "O10": (
        "Three repetitions at 15 cm. Likely: without shadows the crowns have little contrast, and the "
        "surfaces of the repetitions differ more; on the mesh the difference is larger still (69 and 30 "
        "%). Not tested with other exposure or more repetitions."
    ),
    "collapse": (
        "Both collapse: the virtual line is as steep as the published one, with the same scatter. Its "
        "level differs: the virtual stand reaches the same unmatched share at a fifth of the disparity or "
        "less. It bends at 30 cm (above the line by half a logit)."
    ),
}
"""Number of a finding (or ``collapse``) -> a sentence or two."""
