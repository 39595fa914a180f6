//! What decides where a box goes, by name.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context as _;
use packing::{
    ContainerOrder, Draw, Extent, Grid, HarmonicColumns, Heuristic, Placement, WalleWeights, corner_candidates,
    random_place,
};
use policy::{Engine, Model, Policy, PolicyKind};

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
    /// A network, with the container order that it was trained for.
    Network(PolicyKind, Arc<Model>),
}

/// Decides for the boxes of one episode: the grid, the box and the boxes known to come after it.
pub(crate) type Chooser<'a> = Box<dyn FnMut(&Grid, Extent, &[Extent]) -> anyhow::Result<Option<Placement>> + 'a>;

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
    pub(crate) const DEFAULT: &'static str =
        "first-fit,floor,column,walle,walle-corners,harmonic,packman-published,packman,packman-lookahead";

    /// The method called `name`: `method`, `method/container-order` or, for those with a network, `method:file`.
    pub(crate) fn parse(name: &str, settings: &Settings) -> anyhow::Result<Self> {
        let (name, file) = split(name, ':');
        let (base, own_order) = split(name, '/');
        let own_order: Option<ContainerOrder> = own_order.map(str::parse).transpose().map_err(anyhow::Error::msg)?;
        let (kind, published) = match base {
            "harmonic" => (Kind::Harmonic, ContainerOrder::FirstThatFits),
            "random" => (Kind::Random, ContainerOrder::AllOpen),
            _ => match (base.parse::<Heuristic>(), base.parse::<PolicyKind>()) {
                (Ok(heuristic), _) => {
                    (Kind::Heuristic(with_weights(heuristic, settings.weights)), ContainerOrder::FirstThatFits)
                }
                (_, Ok(kind)) => (Kind::Network(kind, load(kind, file)?), ContainerOrder::FirstThatFits),
                _ => return Err(unknown(base)),
            },
        };
        let has_choice = matches!(kind, Kind::Heuristic(_) | Kind::Random);
        anyhow::ensure!(has_choice || own_order.is_none(), "{base} has its own container order: leave \"/...\" out");
        let is_network = matches!(kind, Kind::Network(..));
        anyhow::ensure!(is_network || file.is_none(), "{base} has no network: leave \":...\" out");
        let order = if has_choice { own_order.or(settings.order).unwrap_or(published) } else { published };
        let mut full_name = base.to_owned();
        if order != published {
            full_name = format!("{base}/{order}");
        }
        if let Some(file) = file {
            let stem = Path::new(file).file_stem().unwrap_or_default().to_string_lossy();
            full_name = format!("{base}:{stem}");
        }
        Ok(Self { name: full_name, kind, order })
    }

    /// A chooser for one episode. The same seed and episode give the same choices.
    pub(crate) fn chooser(&self, seed: u64, episode: usize) -> anyhow::Result<Chooser<'_>> {
        let order = self.order;
        Ok(match &self.kind {
            Kind::Heuristic(heuristic) => {
                Box::new(move |grid, extent, _upcoming| Ok(heuristic.choose_in(order, grid, extent)))
            }
            Kind::Harmonic => {
                let mut columns = HarmonicColumns::default();
                Box::new(move |grid, extent, _upcoming| Ok(columns.choose(grid, extent)))
            }
            Kind::Random => {
                let mut draw = Draw::new(RANDOM_PURPOSE, seed, episode as u64);
                Box::new(move |grid, extent, _upcoming| Ok(random_place(order, grid, extent, &mut draw)))
            }
            Kind::Network(kind, model) => {
                let mut policy = Policy::new(*kind, Engine::default(), Some(model))?;
                let mut candidates = Vec::new();
                Box::new(move |grid, extent, upcoming| {
                    corner_candidates(grid, extent, &WalleWeights::PAPER, &mut candidates);
                    let choice = policy.choose(grid, extent, upcoming, &candidates)?;
                    Ok(choice.map(|choice| candidates[choice.index].placement))
                })
            }
        })
    }
}

/// What stands before and behind the first `mark`.
fn split(name: &str, mark: char) -> (&str, Option<&str>) {
    name.split_once(mark).map_or((name, None), |(before, behind)| (before, Some(behind)))
}

/// The model in a file, or the one that ships, if it is one for this kind.
fn load(kind: PolicyKind, file: Option<&str>) -> anyhow::Result<Arc<Model>> {
    let model = match file {
        Some(file) => Some(Model::load(Path::new(file))?),
        None => kind.built_in_model()?,
    };
    Policy::new(kind, Engine::default(), model.as_ref())?;
    model.map(Arc::new).with_context(|| format!("no model ships for {kind}"))
}

fn unknown(name: &str) -> anyhow::Error {
    let heuristics = Heuristic::NAMES.join(", ");
    let networks: Vec<_> = PolicyKind::NAMES.into_iter().filter(|name| !Heuristic::NAMES.contains(name)).collect();
    let networks = networks.join(", ");
    anyhow::anyhow!("there is no policy {name:?}: use {heuristics}, harmonic, random, {networks}")
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
        assert!(name("best-fit", &SETTINGS).unwrap_err().contains("random, packman"));
        assert_eq!(name("packman", &all_open), Ok("packman".to_owned()));
        assert!(name("walle:model.safetensors", &SETTINGS).unwrap_err().contains("no network"));
        assert!(name("packman:missing.safetensors", &SETTINGS).unwrap_err().contains("missing.safetensors"));
    }
}
