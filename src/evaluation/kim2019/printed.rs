//! The numbers that the paper prints [Kim19 Table 1, §III-A, Tables 3–7]; its Figs 13–18 are pictures only.

/// Table 1: timing difference in frames, 3-D error in centimetres.
pub const TABLE_1: [(f64, f64); 7] = [
    (-0.75, 5.07),
    (-0.5, 3.4),
    (-0.25, 1.70),
    (0.0, 0.53),
    (0.25, 1.75),
    (0.5, 3.43),
    (0.75, 5.12),
];

/// Mean distance between points and model: F1, F2, pixels.
pub const MISFIT_PX: [f64; 2] = [6.0179, 0.0304];

/// One trial of Tables 3–6: |τ − τ*| in frames and reprojection error in pixels.
pub type Trial = (f64, f64);

/// Tables 3–6: τ2 in frames, four trials of F1, four of F2. (Its τ* are printed negative.)
pub const TABLES_3_TO_6: [(f64, &str, [Trial; 4], [Trial; 4]); 4] = [
    (
        1.0 / 3.0,
        "1/3",
        [
            (0.1119, 0.1704),
            (0.0596, 0.1843),
            (0.0190, 0.1685),
            (0.1113, 0.1688),
        ],
        [
            (0.0078, 0.1116),
            (0.0074, 0.1085),
            (0.0098, 0.1079),
            (0.0091, 0.1111),
        ],
    ),
    (
        0.5,
        "1/2",
        [
            (0.0835, 0.1599),
            (0.0970, 0.1656),
            (0.0734, 0.1620),
            (0.1591, 0.1629),
        ],
        [
            (0.0078, 0.0937),
            (0.0015, 0.0930),
            (0.0055, 0.0951),
            (0.0085, 0.0927),
        ],
    ),
    (
        2.0 / 3.0,
        "2/3",
        [
            (0.0582, 0.1655),
            (0.0205, 0.1820),
            (0.0261, 0.1675),
            (0.0287, 0.1632),
        ],
        [
            (0.0124, 0.1123),
            (0.0115, 0.1058),
            (0.0086, 0.1037),
            (0.0169, 0.1018),
        ],
    ),
    (
        1.0,
        "1",
        [
            (0.1663, 0.1721),
            (0.1912, 0.2263),
            (0.1223, 0.1725),
            (0.0817, 0.1701),
        ],
        [
            (0.0009, 0.0931),
            (0.0022, 0.0915),
            (0.0067, 0.0914),
            (0.0075, 0.0920),
        ],
    ),
];

/// Table 7 and Fig. 23: mean |τ − τ*| (frames) and reprojection error (pixels) of F1 and F2, and the reprojection
/// error of synchronised cameras.
pub const TABLE_7: ([f64; 2], [f64; 2], f64) = ([0.0881, 0.1726], [0.0077, 0.1003], 0.083);
