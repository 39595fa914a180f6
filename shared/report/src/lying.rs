//! A container whose boxes lie as they fell, seen from where [`isometric`](crate::isometric) looks.

use std::fmt::Write as _;

use packing::ContainerSize;

use crate::escape;
use crate::isometric::{View, hue_deg, picture};

/// A box as it lies, level or not.
#[derive(Clone, Debug, PartialEq)]
pub struct Lying {
    /// The box's identity, which gives it its colour.
    pub box_id: u64,
    /// What is said of it as a tooltip.
    pub about: String,
    /// Its corners in the container [mm]: bit 0, 1 and 2 of the index say on which end of its three axes each lies.
    pub corners_mm: [[f64; 3]; 8],
}

/// The boxes of one container as an SVG picture, each with a tooltip.
///
/// Whole boxes are drawn from the back to the front. Where three hide each other in a circle, the one that is farthest
/// away is drawn first, so a corner of it can be missing.
#[must_use]
pub fn isometric_lying(size: ContainerSize, boxes: &[Lying]) -> String {
    let view = View::of(size).with_room_for(boxes.iter().flat_map(|lying| lying.corners_mm));
    picture(size, view, boxes.len(), |svg, view| {
        for index in painters_order(boxes) {
            boxes[index].push(svg, view);
        }
    })
}

/// From a point to the viewer.
const TO_VIEWER: [f64; 3] = [1.0; 3];

/// Two boxes that are in each other by less than this only touch [mm]; and so much of a direction is none [-].
const TOUCH: f64 = 1e-3;

/// Indices from the back to the front.
fn painters_order(boxes: &[Lying]) -> Vec<usize> {
    let mut waiting: Vec<usize> = (0..boxes.len()).collect();
    waiting.sort_by(|&a, &b| boxes[a].depth().total_cmp(&boxes[b].depth()));
    let mut drawn = Vec::with_capacity(boxes.len());
    while !waiting.is_empty() {
        let hidden_by_none = |&index: &usize| !waiting.iter().any(|&other| boxes[other].is_behind(&boxes[index]));
        drawn.push(waiting.remove(waiting.iter().position(hidden_by_none).unwrap_or(0)));
    }
    drawn
}

impl Lying {
    /// How near to the viewer its middle lies.
    fn depth(&self) -> f64 {
        self.corners_mm.iter().flatten().sum()
    }

    /// The directions of its axes, not of length 1.
    fn axes(&self) -> [[f64; 3]; 3] {
        [1, 2, 4].map(|far| minus(self.corners_mm[far], self.corners_mm[0]))
    }

    /// Least and most of its corners along a direction.
    fn interval(&self, direction: [f64; 3]) -> [f64; 2] {
        let along = self.corners_mm.map(|corner| dot(corner, direction));
        [along.into_iter().fold(f64::INFINITY, f64::min), along.into_iter().fold(f64::NEG_INFINITY, f64::max)]
    }

    /// Whether it must be drawn before the other. Two cuboids that are apart are so along a side of one of them or
    /// across an edge of each; the plane between them says which of them the viewer sees first.
    fn is_behind(&self, other: &Self) -> bool {
        let (own, others) = (self.axes(), other.axes());
        let across = own.iter().flat_map(|&a| others.map(|b| cross(a, b)));
        let directions = own.into_iter().chain(others).chain(across);
        let (mut widest_mm, mut is_behind) = (f64::NEG_INFINITY, false);
        for direction in directions {
            let length = dot(direction, direction).sqrt();
            if length < TOUCH {
                continue;
            }
            let unit = direction.map(|part| part / length);
            let ([low, high], [other_low, other_high]) = (self.interval(unit), other.interval(unit));
            let (before_mm, after_mm) = (other_low - high, low - other_high);
            let gap_mm = before_mm.max(after_mm);
            let towards_viewer = dot(unit, TO_VIEWER);
            if towards_viewer.abs() < TOUCH {
                // A plane that the viewer sees edge-on keeps the two pictures apart.
                if gap_mm > -TOUCH {
                    return false;
                }
            } else if gap_mm > widest_mm {
                (widest_mm, is_behind) = (gap_mm, (before_mm > after_mm) == (towards_viewer > 0.0));
            }
        }
        is_behind && self.overlaps_on_screen(other)
    }

    /// Whether the pictures can overlap: in all three directions that are seen at their full length.
    fn overlaps_on_screen(&self, other: &Self) -> bool {
        [[1.0, -1.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, -1.0]].into_iter().all(|direction| {
            let ([low, high], [other_low, other_high]) = (self.interval(direction), other.interval(direction));
            low + TOUCH < other_high && other_low + TOUCH < high
        })
    }

    /// The faces that look at the viewer.
    fn push(&self, svg: &mut String, view: &View) {
        let _ = writeln!(svg, "<g><title>box {}: {}</title>", self.box_id, escape(&self.about));
        let hue = hue_deg(self.box_id);
        let axes = self.axes();
        for (axis, far) in [0, 1, 2].into_iter().flat_map(|axis| [(axis, false), (axis, true)]) {
            let sign = if far { 1.0 } else { -1.0 } / dot(axes[axis], axes[axis]).sqrt().max(TOUCH);
            let [x, y, z] = axes[axis].map(|part| part * sign);
            if x + y + z < TOUCH {
                continue;
            }
            // A face is as light as those of level boxes that it looks like.
            let shade = |of_x: f64, of_y: f64, of_z: f64| of_x * x * x + of_y * y * y + of_z * z * z;
            let (saturation, lightness) = (shade(36.0, 32.0, 45.0), shade(66.0, 54.0, 77.0));
            let (first, second) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
            let start = usize::from(far) << axis;
            let corners = [start, start | first, start | first | second, start | second];
            let commands = ['M', 'L', 'L', 'L'].into_iter().zip(corners);
            let path: String = commands.map(|(command, corner)| view.point(command, self.corners_mm[corner])).collect();
            let _ = writeln!(
                svg,
                "<path d=\"{path}Z\" fill=\"hsl({hue:.0} {saturation:.0}% {lightness:.0}%)\" stroke=\"hsl({hue:.0} 35% \
                 25%)\"/>"
            );
        }
        svg.push_str("</g>\n");
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box around a point, tipped about `x` by an angle.
    fn lying(box_id: u64, middle_mm: [f64; 3], half_mm: [f64; 3], tip_deg: f64) -> Lying {
        let (sin, cos) = tip_deg.to_radians().sin_cos();
        let corners_mm = std::array::from_fn(|corner| {
            let [x, y, z] = [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { half_mm[axis] } else { -half_mm[axis] });
            let tipped = [x, cos * y - sin * z, sin * y + cos * z];
            [0, 1, 2].map(|axis| middle_mm[axis] + tipped[axis])
        });
        Lying { box_id, about: "a < b".to_owned(), corners_mm }
    }

    #[test]
    fn what_is_behind_left_or_below_comes_first() {
        let (front, back) = (lying(1, [30.0, 10.0, 10.0], [10.0; 3], 0.0), lying(2, [10.0; 3], [10.0; 3], 0.0));
        let above = lying(3, [10.0, 10.0, 30.0], [10.0; 3], 0.0);
        assert!(back.is_behind(&front) && !front.is_behind(&back));
        assert!(back.is_behind(&above) && !above.is_behind(&back));
        assert_eq!(painters_order(&[front, above, back.clone()])[0], 2);
        let apart = lying(4, [5.0, 95.0, 5.0], [5.0; 3], 0.0);
        assert!(!back.is_behind(&apart) && !apart.is_behind(&back), "they do not meet on the screen");
    }

    /// A plank leans on a cube, with its foot on the floor before it: it hides a part of the cube.
    #[test]
    fn what_leans_on_a_box_from_before_hides_it() {
        let cube = lying(1, [50.0, 50.0, 50.0], [50.0; 3], 0.0);
        let plank = lying(2, [50.0, 140.0, 60.0], [50.0, 80.0, 5.0], -45.0);
        assert!(cube.is_behind(&plank) && !plank.is_behind(&cube));
        let size = ContainerSize::new(20, 20, 20, 10).unwrap();
        let svg = isometric_lying(size, &[plank, cube]);
        assert!(svg.find("box 1").unwrap() < svg.find("box 2").unwrap());
        assert!(svg.contains("<title>box 2: a &lt; b</title>"), "{svg}");
    }

    #[test]
    fn what_sticks_out_of_its_container_is_in_the_picture() {
        let size = ContainerSize::new(10, 10, 10, 10).unwrap();
        let svg = isometric_lying(size, &[lying(1, [50.0, 50.0, 400.0], [150.0; 3], 0.0)]);
        let number = |name: &str| -> f64 {
            svg.split(&format!(" {name}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        let (width, height) = (number("width"), number("height"));
        for path in svg.split(" d=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
            for point in path.split(['M', 'L', 'Z']).filter(|point| !point.is_empty()) {
                let (x, y) = point.split_once(' ').unwrap();
                let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
                assert!((0.0..=width + 1.0).contains(&x) && (0.0..=height + 1.0).contains(&y), "{x}, {y}");
            }
        }
    }

    #[test]
    fn a_level_box_looks_as_it_does_in_a_packing() {
        use packing::{BoxSpec, PlacedBox, Placement, Yaw};
        let size = ContainerSize::new(10, 10, 10, 10).unwrap();
        let spec = BoxSpec::new(7, [20, 30, 40]).unwrap();
        let placement = Placement { slot: 0, yaw: Yaw::Deg0, i: 1, j: 2, base: 3 };
        let packed = crate::isometric(size, packing::Rules::default(), &[PlacedBox { spec, placement, container: 0 }]);
        let lying = isometric_lying(size, &[lying(7, [20.0, 35.0, 50.0], [10.0, 15.0, 20.0], 0.0)]);
        let fills = |svg: &str| {
            let fills = svg.split("fill=\"hsl").skip(1).map(|rest| rest.split('"').next().unwrap().to_owned());
            fills.collect::<std::collections::BTreeSet<_>>()
        };
        assert_eq!(fills(&packed), fills(&lying));
        let points = |svg: &str| {
            let paths = svg.split("<g><title>").nth(1).unwrap().split("d=\"").skip(1);
            let points =
                paths.flat_map(|path| path.split(['M', 'L', 'Z']).take(5).map(str::to_owned).collect::<Vec<_>>());
            points
                .filter(|point| point.contains(' ') && !point.contains('"'))
                .collect::<std::collections::BTreeSet<_>>()
        };
        assert_eq!(points(&packed), points(&lying));
    }
}
