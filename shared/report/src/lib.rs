//! Pictures and pages of packing results, pure: data in, strings out.
//!
//! A page is one file that shows in any browser without a network: tables, charts and packed containers as inline
//! SVG, in light, dark and print. Text from outside is escaped wherever it enters.

mod bars;
mod boxplot;
mod chart;
mod curves;
mod escape;
mod isometric;
mod lying;
mod page;
mod table;
mod wide;

pub use bars::stacked_bars;
pub use boxplot::{Spread, box_plot_groups, box_plots};
pub use chart::standalone;
pub use curves::{Line, LineChart, line_charts};
pub use escape::escape;
pub use isometric::isometric;
pub use lying::{Lying, isometric_lying};
pub use page::Page;
pub use table::Table;
pub use wide::{Limit, Named, Scale, Timeline, percentile_curves, stack, timeline};
