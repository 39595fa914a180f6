//! The paper's table of results, to be set beside ours. Paper: table "Comparison of results", 100 episodes.

/// One row of the paper's table.
#[derive(Debug)]
pub(crate) struct Published {
    /// Our name of the method.
    pub(crate) method: &'static str,
    /// Its name in the table.
    pub(crate) name: &'static str,
    /// Competitive ratio [-].
    pub(crate) c: f64,
    /// Mean time of a decision [us].
    pub(crate) time_us: Option<u32>,
    /// Average packing of the first containers [%].
    pub(crate) fill_percent: Option<f64>,
    /// Share of episodes in which it packed best [%].
    pub(crate) best_percent: Option<u32>,
}

/// The data set that the table is about, as this project reads the paper.
pub(crate) const DATA: &str = "standard";

/// The table.
pub(crate) const TABLE: [Published; 6] = [
    row("first-fit", "First Fit", 1.47, 200, 81.3, 7),
    row("floor", "Floor building", 1.52, 200, 81.0, 5),
    row("column", "Column build", 1.46, 100, 81.0, 6),
    row("walle", "WallE", 1.41, 10_600, 81.8, 25),
    row("packman-published", "PackMan", 1.29, 34_200, 82.8, 57),
    Published { method: "harmonic", name: "AH", c: 1.58, time_us: None, fill_percent: None, best_percent: None },
];

/// What the row `AH` is.
pub(crate) const AH_REMARK: &str = "AH (Advanced Harmonic) is quoted as a bound: c of at most 1.58 is proved for \
                                    one-dimensional packing, it was never run on boxes. harmonic is a runnable \
                                    relative: columns of one footprint class each.";

const fn row(method: &'static str, name: &'static str, c: f64, time_us: u32, fill: f64, best: u32) -> Published {
    Published { method, name, c, time_us: Some(time_us), fill_percent: Some(fill), best_percent: Some(best) }
}

/// The paper's row of a method.
pub(crate) fn row_of(method: &str) -> Option<&'static Published> {
    TABLE.iter().find(|row| row.method == method)
}
