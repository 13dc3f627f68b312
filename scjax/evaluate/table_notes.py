"""Notes that say how to read the tables, and values that others published on other data."""

from __future__ import annotations

_FLOOR = (
    "The floor compares two equally large sets of real scenes of different locations: mean and central 95 % "
    "over splits. "
    "A value within it is not significantly different from real scenes at this number of scenes. With a few hundred "
    "scenes, only connection gaps, lengths, widths and the control metrics separate models. "
)

NOTES = {
    "strict": "Against the real scenes, scaled as in the published tables: Frechet distances of the lane graph "
    "(connectivity and convenience x10), squared Jensen-Shannon distances of vehicles (x10, x100), route length and "
    "connection gap in metres, vehicles that overlap another in percent. Independent of the order of lanes; "
    "distances to "
    "segments; exact boxes. " + _FLOOR,
    "compat": "As Scenario Dreamer's code computes them: its grouping of key points, distances to lane points, circles "
    "instead of boxes. Only these values compare with published ones, and only over as many scenes. " + _FLOOR,
    "faults": "Connection gap [m] from the end of a lane to the start of the next, and share above 1 m; share "
    "of vehicles "
    "within 1.5 m of a centerline, and of these, share more than 45 degrees off its heading; overlaps of exact boxes. "
    "Real scenes have overlaps too, mostly of pedestrians: the target is their rate, not 0. Distance of the "
    "ego from the "
    "origin, and share of scenes whose ego does not look along x: such scenes are in another frame.",
    "match": "Agents of scene i against those of its reference, without the ego, same class, mean over 1, 2, 3 m. "
    "M: matches / reference agents; P: matches / generated agents; PxR: mean of the products. AP: average "
    "precision; its "
    "score, the distance to the ego, is uninformative, so AP falls to about PxR. AP_consensus: scored by how many "
    "other samples of the condition agree. nuscenes ignores recall and precision below 0.1.",
    "control": "Sample i against the reference whose condition it got. CCS: mean cosine of descriptors; SPG: "
    "CCS minus CCS "
    "with references of other locations; CSC: correlation of distances between scenes. lane and agent describe the "
    "placement of elements, not their number; glob describes the whole scene. Compare orders, and ratios to the rows "
    "'other scene, same counts' and 'copy', not absolute values. Intervals resample locations, not pairs.",
    "gains": "Differences in CCS and CSC between two methods with the same references, with the interval of the "
    "difference; both methods use the same bootstrap samples. Over a method with shuffled conditions and the "
    "same counts, "
    "the gain in CCS is SPG_prompt, the contribution of the prompt: 0 for a model that ignores it.",
    "attributes": "Share of the attributes of a reference that the scene shows, numbers exactly, by group "
    "(docs/attributes.md). Methods whose scenes were chosen by attributes have no row.",
    "counts": "Generated against reference: mean absolute error and bias, share exact, within 1 and within 10 percent, "
    "rank correlation. Agents without the ego.",
}

PUBLISHED_NOTE = (
    "Other data, other numbers of scenes (50,000) and other code: do not compare with the tables above, whose "
    "floor at a "
    "few hundred scenes is higher than these values. The rows of Scenario Dreamer and DriveSceneGen come from the "
    "repository of Scenario Dreamer, those of ScenarioControl from its paper."
)

PUBLISHED: dict[str, dict[str, str]] = {
    "Scenario Dreamer L (Waymo)": {
        "connectivity": "0.10",
        "density": "0.26",
        "reach": "0.26",
        "convenience": "1.29",
        "route m": "38.80 ± 13.56",
        "connection gap m": "0.21 ± 0.81",
        "nearest": "0.05",
        "lateral": "0.03",
        "angular": "0.08",
        "length": "0.43",
        "width": "0.29",
        "speed": "0.38",
        "vehicles overlapping %": "4.01",
    },
    "Scenario Dreamer L (nuPlan)": {
        "connectivity": "0.08",
        "density": "0.25",
        "reach": "0.05",
        "convenience": "0.40",
        "route m": "36.68 ± 10.39",
        "connection gap m": "0.25 ± 0.71",
        "nearest": "0.08",
        "lateral": "0.10",
        "angular": "0.11",
        "length": "0.25",
        "width": "0.20",
        "speed": "0.06",
        "vehicles overlapping %": "9.22",
    },
    "DriveSceneGen (Waymo)": {
        "connectivity": "4.53",
        "density": "1.18",
        "reach": "0.64",
        "convenience": "5.58",
        "route m": "41.61 ± 18.61",
        "connection gap m": "0.01 ± 0.00",
        "nearest": "0.63",
        "lateral": "1.01",
        "angular": "2.43",
        "length": "58.86",
        "width": "54.51",
        "speed": "18.70",
        "vehicles overlapping %": "0.2",
    },
    "ScenarioControl, image (nuPlan)": {"AP": "33.46", "scenes with a collision %": "17.07"},
    "ScenarioControl, prompt (nuPlan)": {"AP": "23.36", "scenes with a collision %": "20.07"},
    "ScenarioControl on real lanes (WOMD)": {"AP": "26.8"},
    "TrafficGen on real lanes (WOMD)": {"AP": "5.5"},
}
