"""How to read the tables, and what others have published on other data."""

from __future__ import annotations

_FLOOR = (
    "The floor is what as many real scenes of other locations say: mean and the range of 95 % of the draws. A value "
    "within it cannot be told from real scenes at this number of scenes; with a few hundred, that leaves the gap of "
    "joined lanes, lengths and widths, and the control metrics to separate models. "
)

NOTES = {
    "strict": "Against the real scenes, scaled as in the published tables: Frechet distances of the lane graph "
    "(connectivity and convenience x10), squared Jensen-Shannon distances of vehicles (x10, x100), route and joint gap "
    "in metres, vehicles that overlap another in percent. Independent of the order of lanes; distances to segments; "
    "exact boxes. " + _FLOOR,
    "compat": "As Scenario Dreamer's code counts: its grouping of key points, vehicles against lane points, circles "
    "for boxes. Only these values compare with published ones, and only over as many scenes. " + _FLOOR,
    "faults": "Joint gap [m] from the end of a lane to the start of the next, share above 1 m; share of vehicles "
    "within 1.5 m of a centreline and of those more than 45 degrees off it; overlaps of exact boxes. Real scenes have "
    "overlaps too, of pedestrians mostly: their rate is the target for all classes, not 0. The ego's distance from the "
    "origin, and the share of scenes whose ego looks another way than along x: theirs is another frame.",
    "match": "Agents of scene i against those of its reference, the ego left out, same class, mean over 1, 2, 3 m. "
    "M: matches over reference agents; P: over generated ones; PxR: mean of the products. AP: average precision scored "
    "by the distance to the ego, which says nothing, so that it falls to about PxR; AP_consensus: scored by how many "
    "other samples of the condition agree. nuscenes counts nothing below recall and precision 0.1.",
    "control": "Sample i against the reference whose condition it got. CCS: mean cosine of descriptors; SPG: less that "
    "with references of other locations; CSC: correlation of distances between scenes. lane and agent say how elements "
    "are placed and not how many there are; glob is the whole scene. Only orderings and ratios to the rows "
    "'other scene, same counts' and 'copy' mean something; intervals draw locations, not pairs.",
    "gains": "Differences in CCS and CSC between two rows made for the same references, with the interval of the "
    "difference: both rows see the same drawn locations. Over a row made from another's condition at the same counts, "
    "the gain in CCS is SPG_prompt, what the prompt itself adds: 0 for a model that ignores it.",
    "captions": "Facts by the captioner's rules, of the scene and of its reference: F1 where a scene has or lacks "
    "something, share of scenes that agree otherwise. Red lights count where the reference records signals.",
    "counts": "Generated against the reference's: mean error and bias, share exact, within 1 and within 10 percent, "
    "rank correlation. Agents without the ego.",
}

PUBLISHED_NOTE = (
    "Other data, other numbers of scenes (50,000), other code: not to be compared with the tables above, whose floor "
    "at a few hundred scenes is higher than these values. Scenario Dreamer's and DriveSceneGen's rows are from its "
    "repository, ScenarioControl's from its paper."
)

PUBLISHED: dict[str, dict[str, str]] = {
    "Scenario Dreamer L (Waymo)": {
        "connectivity": "0.10",
        "density": "0.26",
        "reach": "0.26",
        "convenience": "1.29",
        "route m": "38.80 ± 13.56",
        "joint gap m": "0.21 ± 0.81",
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
        "joint gap m": "0.25 ± 0.71",
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
        "joint gap m": "0.01 ± 0.00",
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
