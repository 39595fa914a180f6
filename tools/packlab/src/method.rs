//! What decides where a box goes, by name.

use packing::{ContainerOrder, Draw, Extent, Grid, HarmonicColumns, Heuristic, Placement, WalleWeights, random_place};

/// Tells the draws of `random` from those that make episodes.
const RANDOM_PURPOSE: u64 = 0x7261_6e64_6f6d;

/// A method under its name, with every choice made but the boxes.
#[derive(Clone, Debug)]
pub(crate) struct Method {
    /// As it is called in tables: with its container order where that is not the published one.
    pub(crate) name: String,
    kind: Kind,
    order: ContainerOrder,
}

#[derive(Clone, Debug)]
enum Kind {
    Heuristic(Heuristic),
    Harmonic,
    Random,
}

/// Decides for the boxes of one episode: the grid, the box and the boxes known to come after it.
pub(crate) type Chooser<'a> = Box<dyn FnMut(&Grid, Extent, &[Extent]) -> Option<Placement> + 'a>;

/// What the methods share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Settings {
    /// For every method that has a choice of container order; otherwise each one's published reading.
    pub(crate) order: Option<ContainerOrder>,
    /// For both WallEs.
    pub(crate) weights: WalleWeights,
}

impl Method {
    /// The methods that are compared unless told otherwise.
    pub(crate) const DEFAULT: &'static str = "first-fit,floor,column,walle,walle-corners,harmonic";

    /// The method called `name`, which may end in `/all-open` or `/first-that-fits`.
    pub(crate) fn parse(name: &str, settings: &Settings) -> anyhow::Result<Self> {
        let (base, own_order) = match name.split_once('/') {
            Some((base, order)) => (base, Some(order.parse().map_err(anyhow::Error::msg)?)),
            None => (name, None),
        };
        let (kind, published) = match base {
            "harmonic" => (Kind::Harmonic, ContainerOrder::FirstThatFits),
            "random" => (Kind::Random, ContainerOrder::AllOpen),
            _ => {
                let heuristic: Heuristic = base.parse().map_err(|_| unknown(base))?;
                (Kind::Heuristic(with_weights(heuristic, settings.weights)), ContainerOrder::FirstThatFits)
            }
        };
        anyhow::ensure!(
            own_order.is_none() || !matches!(kind, Kind::Harmonic),
            "harmonic has its own container order: leave \"/...\" out"
        );
        let order = match kind {
            Kind::Harmonic => published,
            Kind::Heuristic(_) | Kind::Random => own_order.or(settings.order).unwrap_or(published),
        };
        let name = if order == published { base.to_owned() } else { format!("{base}/{order}") };
        Ok(Self { name, kind, order })
    }

    /// A chooser for one episode. The same seed and episode give the same choices.
    pub(crate) fn chooser(&self, seed: u64, episode: usize) -> Chooser<'_> {
        let order = self.order;
        match &self.kind {
            Kind::Heuristic(heuristic) => {
                Box::new(move |grid, extent, _upcoming| heuristic.choose_in(order, grid, extent))
            }
            Kind::Harmonic => {
                let mut columns = HarmonicColumns::default();
                Box::new(move |grid, extent, _upcoming| columns.choose(grid, extent))
            }
            Kind::Random => {
                let mut draw = Draw::new(RANDOM_PURPOSE, seed, episode as u64);
                Box::new(move |grid, extent, _upcoming| random_place(order, grid, extent, &mut draw))
            }
        }
    }
}

fn unknown(name: &str) -> anyhow::Error {
    let heuristics = Heuristic::NAMES.join(", ");
    anyhow::anyhow!("there is no policy {name:?}: use {heuristics}, harmonic or random")
}

fn with_weights(heuristic: Heuristic, weights: WalleWeights) -> Heuristic {
    match heuristic {
        Heuristic::Walle(_) => Heuristic::Walle(weights),
        Heuristic::WalleCorners(_) => Heuristic::WalleCorners(weights),
        Heuristic::FirstFit | Heuristic::Floor | Heuristic::Column => heuristic,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Settings = Settings { order: None, weights: WalleWeights::PAPER };

    fn name(text: &str, settings: &Settings) -> Result<String, String> {
        Method::parse(text, settings).map(|method| method.name).map_err(|error| error.to_string())
    }

    #[test]
    fn a_method_is_called_by_its_name_and_its_order_where_it_differs() {
        let all_open = Settings { order: Some(ContainerOrder::AllOpen), ..SETTINGS };
        assert_eq!(name("floor", &SETTINGS), Ok("floor".to_owned()));
        assert_eq!(name("floor/first-that-fits", &SETTINGS), Ok("floor".to_owned()));
        assert_eq!(name("floor/all-open", &SETTINGS), Ok("floor/all-open".to_owned()));
        assert_eq!(name("floor", &all_open), Ok("floor/all-open".to_owned()));
        assert_eq!(name("harmonic", &all_open), Ok("harmonic".to_owned()));
        assert_eq!(name("random", &all_open), Ok("random".to_owned()));
        assert!(name("harmonic/all-open", &SETTINGS).is_err());
        assert!(name("floor/sideways", &SETTINGS).unwrap_err().contains("all-open"));
        assert!(name("best-fit", &SETTINGS).unwrap_err().contains("harmonic or random"));
    }
}
