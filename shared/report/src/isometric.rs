//! A packed container, seen from its front corner and above.

use std::fmt::Write as _;

use packing::{ContainerSize, PlacedBox, Rules, Yaw};

/// Width of the picture [px] before a page scales it.
const WIDTH_PX: f64 = 320.0;

/// Room around the picture for its strokes [px].
const MARGIN_PX: f64 = 4.0;

/// Most parts that boxes are cut into so that they can be drawn one after the other. Real packings need a handful.
const PARTS_MAX: usize = 10_000;

/// Angle between the hues of two boxes that follow each other [deg]: the golden angle keeps any few apart.
const HUE_STEP_DEG: f64 = 137.508;

/// The boxes of one container, packed by these rules, as an SVG picture, each with its number, size and place as a
/// tooltip. A box stands in the middle of its room, with its clearance around it.
///
/// The viewer looks from the far end of `i` and `j`, so the container's origin is the corner at the back.
#[must_use]
pub fn isometric(size: ContainerSize, rules: Rules, boxes: &[PlacedBox]) -> String {
    picture(size, View::of(size), boxes.len(), |svg, view| {
        let cuboids: Vec<_> = boxes.iter().map(|placed| Cuboid::of(size, rules, placed)).collect();
        for part in painters_order(&cuboids) {
            view.push_part(svg, &part, &cuboids[part.owner], &boxes[part.owner]);
        }
    })
}

/// A container and what `push_boxes` draws in it.
pub(crate) fn picture(
    size: ContainerSize,
    view: View,
    boxes: usize,
    push_boxes: impl FnOnce(&mut String, &View),
) -> String {
    let container = Cuboid::container(size);
    let (width, height) = (view.width_px(), view.height_px());
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" width=\"{width:.0}\" \
         height=\"{height:.0}\" role=\"img\" stroke-linejoin=\"round\" stroke-linecap=\"round\">\n<title>{boxes} boxes in a \
         container of {size}</title>\n<g stroke=\"#8a93a3\" stroke-width=\"0.8\">\n"
    );
    for (face, opacity) in [(container.floor(), 0.10), (container.back_left(), 0.14), (container.back_right(), 0.18)] {
        let _ = writeln!(svg, "<path d=\"{}\" fill=\"#8a93a3\" fill-opacity=\"{opacity}\"/>", view.outline(&face));
    }
    svg.push_str("</g>\n<g stroke-width=\"0.7\">\n");
    push_boxes(&mut svg, &view);
    svg.push_str("</g>\n");
    // The edges nearest to the viewer, thin, so that the empty part of the container shows.
    let edge = |[from, to]: [Point; 2]| format!("{}{}", view.corner('M', from), view.corner('L', to));
    let rim = container.rim().map(edge).concat();
    let _ = writeln!(
        svg,
        "<path d=\"{rim}\" fill=\"none\" stroke=\"#8a93a3\" stroke-width=\"0.8\" stroke-dasharray=\"3 3\"/>"
    );
    svg.push_str("</svg>\n");
    svg
}

/// The colour of a box.
pub(crate) fn hue_deg(box_id: u64) -> f64 {
    (box_id as f64 * HUE_STEP_DEG).rem_euclid(360.0)
}

/// A point of the container [half mm], so that the middle of a room is a whole number.
type Point = [i64; 3];

/// A cuboid in the container [half mm].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cuboid {
    low: Point,
    high: Point,
}

impl Cuboid {
    fn container(size: ContainerSize) -> Self {
        let high = [size.length(), size.breadth(), size.height()].map(|cells| 2 * mm(cells, size));
        Self { low: [0; 3], high }
    }

    fn of(size: ContainerSize, rules: Rules, placed: &PlacedBox) -> Self {
        let PlacedBox { spec, placement, .. } = placed;
        let room = rules.extent(spec, size).turned(placement.yaw);
        let [length_mm, breadth_mm, height_mm] = spec.size_mm().map(i64::from);
        let (along_mm, across_mm) = match placement.yaw {
            Yaw::Deg0 => (length_mm, breadth_mm),
            Yaw::Deg90 => (breadth_mm, length_mm),
        };
        let in_room = |first: u16, cells: u16, side_mm: i64| 2 * mm(first, size) + mm(cells, size) - side_mm;
        let low = [
            in_room(placement.i, room.length, along_mm),
            in_room(placement.j, room.breadth, across_mm),
            2 * mm(placement.base, size),
        ];
        Self { low, high: [low[0] + 2 * along_mm, low[1] + 2 * across_mm, low[2] + 2 * height_mm] }
    }

    fn corner(&self, high: [bool; 3]) -> Point {
        [0, 1, 2].map(|axis| if high[axis] { self.high[axis] } else { self.low[axis] })
    }

    /// The face on the low or high side of an axis, corner after corner.
    fn face(&self, axis: usize, high: bool) -> [Point; 4] {
        let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
        [(false, false), (true, false), (true, true), (false, true)].map(|(on_first, on_second)| {
            let mut corner = [high; 3];
            (corner[first], corner[second]) = (on_first, on_second);
            self.corner(corner)
        })
    }

    fn floor(&self) -> [Point; 4] {
        self.face(2, false)
    }

    fn back_left(&self) -> [Point; 4] {
        self.face(1, false)
    }

    fn back_right(&self) -> [Point; 4] {
        self.face(0, false)
    }

    /// The three edges that meet in the corner nearest to the viewer.
    fn rim(&self) -> [[Point; 2]; 3] {
        [0, 1, 2].map(|axis| {
            let mut end = [true; 3];
            end[axis] = false;
            [self.high, self.corner(end)]
        })
    }

    /// Whether the two pictures overlap. The line of sight is (1, 1, 1), so differences of coordinates do not change
    /// along it, and the picture of a cuboid is a hexagon: one interval in each of the three differences.
    fn overlaps_on_screen(&self, other: &Self) -> bool {
        [(0, 1), (0, 2), (1, 2)].into_iter().all(|(a, b)| {
            let interval = |cuboid: &Self| (cuboid.low[a] - cuboid.high[b], cuboid.high[a] - cuboid.low[b]);
            let ((low, high), (other_low, other_high)) = (interval(self), interval(other));
            low < other_high && other_low < high
        })
    }

    /// Whether it must be drawn before the other: it lies behind it and their pictures overlap.
    fn is_behind(&self, other: &Self) -> bool {
        (0..3).any(|axis| self.high[axis] <= other.low[axis]) && self.overlaps_on_screen(other)
    }

    /// The parts below and above `position` on an axis, if it lies inside.
    fn cut(&self, axis: usize, position: i64) -> Option<[Self; 2]> {
        (self.low[axis] < position && position < self.high[axis]).then(|| {
            let (mut below, mut above) = (*self, *self);
            (below.high[axis], above.low[axis]) = (position, position);
            [below, above]
        })
    }
}

fn mm(cells: u16, size: ContainerSize) -> i64 {
    i64::from(cells) * i64::from(size.cell_mm())
}

/// A box, or a part of one that had to be cut to be drawn.
#[derive(Clone, Copy, Debug)]
struct Part {
    cuboid: Cuboid,
    owner: usize,
}

/// The cuboids from the back to the front: whatever hides a part comes after it.
///
/// Three boxes can hide each other in a circle; then one of them is cut in two, which a packing without overlaps
/// always allows, since columns of single cells have an order.
fn painters_order(cuboids: &[Cuboid]) -> Vec<Part> {
    let mut waiting: Vec<_> = cuboids.iter().enumerate().map(|(owner, &cuboid)| Part { cuboid, owner }).collect();
    let mut drawn = Vec::with_capacity(waiting.len());
    while !waiting.is_empty() {
        let hidden_by_none = |part: &Part| !waiting.iter().any(|other| other.cuboid.is_behind(&part.cuboid));
        if let Some(next) = waiting.iter().position(hidden_by_none) {
            drawn.push(waiting.remove(next));
            continue;
        }
        let circle = circle(&waiting);
        let cut = if drawn.len() + waiting.len() < PARTS_MAX { cut_one(&waiting, &circle) } else { None };
        match cut {
            Some((index, [back, front])) => {
                let owner = waiting[index].owner;
                waiting[index].cuboid = back;
                waiting.insert(index + 1, Part { cuboid: front, owner });
            }
            // Boxes that stand inside each other have no order: any will do.
            None => drawn.push(waiting.remove(circle[0])),
        }
    }
    drawn
}

/// Parts each of which is behind the one before it, the first behind the last. Every part has one behind it here.
fn circle(waiting: &[Part]) -> Vec<usize> {
    let mut walk = vec![0];
    loop {
        let front = waiting[walk[walk.len() - 1]].cuboid;
        let behind = waiting.iter().position(|part| part.cuboid.is_behind(&front)).unwrap_or(0);
        if let Some(start) = walk.iter().position(|&seen| seen == behind) {
            return walk.split_off(start);
        }
        walk.push(behind);
    }
}

/// A part of the circle, cut where another one ends or begins.
fn cut_one(waiting: &[Part], circle: &[usize]) -> Option<(usize, [Cuboid; 2])> {
    let planes = |&other: &usize| {
        let Cuboid { low, high } = waiting[other].cuboid;
        [(0, low[0]), (0, high[0]), (1, low[1]), (1, high[1])]
    };
    circle.iter().find_map(|&index| {
        let mut planes = circle.iter().flat_map(planes);
        planes.find_map(|(axis, position)| Some((index, waiting[index].cuboid.cut(axis, position)?)))
    })
}

/// From cells to pixels.
pub(crate) struct View {
    cell_mm: f64,
    px_per_cell: f64,
    left_cells: f64,
    top_cells: f64,
    size_cells: [f64; 2],
}

impl View {
    pub(crate) fn of(size: ContainerSize) -> Self {
        let [length, breadth, height] = [size.length(), size.breadth(), size.height()].map(f64::from);
        let size_cells = [(length + breadth) * COS_30, (length + breadth) * SIN_30 + height];
        // A tower must not be taller than it is wide by much: pages place these pictures side by side.
        let px_per_cell = (WIDTH_PX / size_cells[0]).min(1.25 * WIDTH_PX / size_cells[1]);
        let cell_mm = f64::from(size.cell_mm());
        Self { cell_mm, px_per_cell, left_cells: length * COS_30, top_cells: height, size_cells }
    }

    /// The same with room for these points [mm] as well, wherever they lie.
    pub(crate) fn with_room_for(mut self, points_mm: impl Iterator<Item = [f64; 3]>) -> Self {
        for point_mm in points_mm {
            let [x, y] = self.on_screen(point_mm);
            let (left, top) = ((-x).max(0.0), (-y).max(0.0));
            (self.left_cells, self.top_cells) = (self.left_cells + left, self.top_cells + top);
            self.size_cells = [(self.size_cells[0]).max(x) + left, (self.size_cells[1]).max(y) + top];
        }
        self
    }

    /// Where a point [mm] is seen, from the upper left corner [cells].
    fn on_screen(&self, point_mm: [f64; 3]) -> [f64; 2] {
        let [i, j, height] = point_mm.map(|mm| mm / self.cell_mm);
        [(j - i) * COS_30 + self.left_cells, (i + j) * SIN_30 - height + self.top_cells]
    }

    fn width_px(&self) -> f64 {
        self.size_cells[0] * self.px_per_cell + 2.0 * MARGIN_PX
    }

    fn height_px(&self) -> f64 {
        self.size_cells[1] * self.px_per_cell + 2.0 * MARGIN_PX
    }

    /// A path command to a point [mm].
    pub(crate) fn point(&self, command: char, point_mm: [f64; 3]) -> String {
        let [x, y] = self.on_screen(point_mm).map(|cells| cells * self.px_per_cell + MARGIN_PX);
        format!("{command}{x:.1} {y:.1}")
    }

    fn corner(&self, command: char, corner: Point) -> String {
        self.point(command, corner.map(|half_mm| half_mm as f64 / 2.0))
    }

    fn outline(&self, corners: &[Point]) -> String {
        let commands = std::iter::once('M').chain(std::iter::repeat('L'));
        let path: String = commands.zip(corners).map(|(command, &corner)| self.corner(command, corner)).collect();
        path + "Z"
    }

    /// The three visible faces of a part: top, and the two that look at the viewer.
    fn push_part(&self, svg: &mut String, part: &Part, whole: &Cuboid, placed: &PlacedBox) {
        let [length, breadth, height] = placed.spec.size_mm();
        let [i, j, base] = whole.low.map(|half_mm| half_mm / 2);
        let _ = writeln!(
            svg,
            "<g><title>box {}: {length} x {breadth} x {height} mm at {i}, {j}, {base} mm</title>",
            placed.spec.id()
        );
        let hue = hue_deg(placed.spec.id());
        for (axis, saturation, lightness) in [(2, 45, 77), (0, 36, 66), (1, 32, 54)] {
            let fill = format!("hsl({hue:.0} {saturation}% {lightness}%)");
            let line = format!("hsl({hue:.0} 35% 25%)");
            let path = self.outline(&part.cuboid.face(axis, true));
            if part.cuboid == *whole {
                let _ = writeln!(svg, "<path d=\"{path}\" fill=\"{fill}\" stroke=\"{line}\"/>");
            } else {
                // A cut is no edge of the box: the face is bordered in its own colour there.
                let _ = writeln!(svg, "<path d=\"{path}\" fill=\"{fill}\" stroke=\"{fill}\"/>");
                let edges = self.edges_of_whole(&part.cuboid.face(axis, true), whole, axis);
                let _ = writeln!(svg, "<path d=\"{edges}\" fill=\"none\" stroke=\"{line}\"/>");
            }
        }
        svg.push_str("</g>\n");
    }

    /// The sides of a part's face that are edges of the whole box.
    fn edges_of_whole(&self, face: &[Point; 4], whole: &Cuboid, axis: usize) -> String {
        let is_edge = |from: Point, to: Point| {
            let on_border = |other: usize| {
                from[other] == to[other] && (from[other] == whole.low[other] || from[other] == whole.high[other])
            };
            (0..3).filter(|&other| other != axis).any(on_border)
        };
        let sides = (0..4).map(|side| (face[side], face[(side + 1) % 4]));
        let edges = sides.filter(|&(from, to)| is_edge(from, to));
        edges.map(|(from, to)| self.corner('M', from) + &self.corner('L', to)).collect()
    }
}

const COS_30: f64 = 0.866_025_403_784_438_6;
const SIN_30: f64 = 0.5;

#[cfg(test)]
mod tests {
    use packing::{BoxSpec, ClosePolicy, Environment, Heuristic, Placement, Recipe, Split, WalleWeights};

    use super::*;

    fn cuboid(low: Point, high: Point) -> Cuboid {
        Cuboid { low, high }
    }

    /// Every part comes after all that are behind it.
    #[track_caller]
    fn check_order(parts: &[Part]) {
        for (index, part) in parts.iter().enumerate() {
            for later in &parts[index + 1..] {
                assert!(!later.cuboid.is_behind(&part.cuboid), "{later:?} is behind {part:?}");
            }
        }
    }

    #[test]
    fn what_is_behind_left_or_below_comes_first() {
        let front = cuboid([2, 0, 0], [4, 2, 2]);
        let back = cuboid([0, 0, 0], [2, 2, 2]);
        let above = cuboid([0, 0, 2], [2, 2, 4]);
        let order: Vec<_> = painters_order(&[front, above, back]).iter().map(|part| part.owner).collect();
        assert_eq!(order, [2, 0, 1]);
        let apart = cuboid([0, 9, 0], [1, 10, 1]);
        assert!(!back.is_behind(&apart), "they do not meet on the screen");
    }

    /// A lies over B, B stands before C, C stands before A: a packing can look like this.
    #[test]
    fn three_that_hide_each_other_in_a_circle_are_cut() {
        let a = cuboid([0, 0, 2], [2, 8, 3]);
        let b = cuboid([0, 4, 0], [8, 8, 2]);
        let c = cuboid([2, 0, 0], [4, 4, 9]);
        assert!(b.is_behind(&a) && a.is_behind(&c) && c.is_behind(&b));
        let parts = painters_order(&[a, b, c]);
        assert!(parts.len() > 3);
        check_order(&parts);
    }

    #[test]
    fn boxes_inside_each_other_are_drawn_all_the_same() {
        let same = cuboid([0; 3], [2; 3]);
        assert_eq!(painters_order(&[same, same, cuboid([1; 3], [3; 3])]).len(), 3);
    }

    #[test]
    fn a_packed_episode_is_drawn_in_order() {
        let episode = Recipe::standard().episode(Split::Test, 1, 0).unwrap();
        let mut environment = Environment::new(episode.container, 16, ClosePolicy::Never).unwrap();
        let walle = Heuristic::WalleCorners(WalleWeights::PAPER);
        for spec in &episode.boxes {
            environment.pack(spec, |grid, extent| walle.choose(grid, extent)).unwrap();
        }
        for container in 0..environment.outcome(None).containers_used {
            let boxes: Vec<_> = environment.placed().iter().filter(|b| b.container == container).copied().collect();
            let cuboids: Vec<_> =
                boxes.iter().map(|placed| Cuboid::of(episode.container, Rules::default(), placed)).collect();
            check_order(&painters_order(&cuboids));
            let svg = isometric(episode.container, Rules::default(), &boxes);
            assert!(svg.matches("<title>box ").count() >= boxes.len());
            assert!(svg.len() < 1000 * (boxes.len() + 3), "{} bytes for {} boxes", svg.len(), boxes.len());
        }
    }

    #[test]
    fn a_box_is_drawn_where_it_stands() {
        let size = ContainerSize::new(10, 10, 10, 10).unwrap();
        let spec = BoxSpec::new(7, [20, 30, 40]).unwrap();
        let placement = Placement { slot: 0, yaw: Yaw::Deg90, i: 1, j: 2, base: 3 };
        let placed = PlacedBox { spec, placement, container: 0 };
        assert_eq!(Cuboid::of(size, Rules::default(), &placed), cuboid([20, 40, 60], [80, 80, 140]));
        // With a clearance it has a cell more on every side, and stands in the middle.
        let clear = Rules { clearance_mm: 6, ..Rules::default() };
        assert_eq!(Cuboid::of(size, clear, &placed), cuboid([40, 60, 60], [100, 100, 140]));
        let svg = isometric(size, Rules::default(), &[placed]);
        assert!(svg.contains("<title>box 7: 20 x 30 x 40 mm at 10, 20, 30 mm</title>"), "{svg}");
    }
}
