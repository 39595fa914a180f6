//! Files as people write them: whole, broken, and broken in every place.

use std::error::Error as _;
use std::fs;

use dataset::{DataSet, FileError, NAMED, Problem, ReadOptions, Skipped};
use packing::{ContainerSize, Split};

const SKIP_BAD: ReadOptions = ReadOptions { container: ContainerSize::PAPER, skip_bad: true };

fn json(text: &str) -> Result<DataSet, Problem> {
    dataset::read_json(text.as_bytes(), &ReadOptions::default())
}

fn csv(text: &str) -> Result<DataSet, Problem> {
    dataset::read_csv(text.as_bytes(), "boxes", &ReadOptions::default())
}

/// The whole message: the problem and its sources, as a tool prints them.
fn message(problem: &Problem) -> String {
    let mut text = problem.to_string();
    let mut source = problem.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}

#[track_caller]
fn refuses(result: Result<DataSet, Problem>, expected: &str) {
    assert_eq!(message(&result.expect_err(expected)), expected);
}

fn in_cm(episodes: &str) -> String {
    format!(r#"{{"meta": {{"name": "n", "unit": "cm", "container": [45, 80, 50]}}, "episodes": {episodes}}}"#)
}

fn sizes(set: &DataSet) -> Vec<Vec<[u32; 3]>> {
    set.episodes.iter().map(|boxes| boxes.iter().map(packing::BoxSpec::size_mm).collect()).collect()
}

#[test]
fn what_is_written_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    for named in &NAMED {
        let set = named.generate(Split::Test, 3, 2).unwrap();
        let path = folder.path().join("set.json");
        dataset::write(&path, &set).unwrap();
        assert_eq!(dataset::read(&path, &ReadOptions::default()).unwrap(), set);
        let path = folder.path().join(format!("{}.CSV", named.name));
        dataset::write(&path, &set).unwrap();
        let options = ReadOptions { container: set.container, skip_bad: false };
        assert_eq!(dataset::read(&path, &options).unwrap(), DataSet { optimum: None, ..set });
    }
}

#[test]
fn units_and_container() {
    let set = json(
        r#"{"episodes": [[[12, 30.5, 20]], [[1, 2, 3]]],
            "meta": {"unit": "cm", "name": "n", "container": [45, 80, 50], "optimum": 2}}"#,
    )
    .unwrap();
    assert_eq!((set.container, set.optimum), (ContainerSize::PAPER, Some(2)));
    assert_eq!(sizes(&set), [[[120, 305, 200]], [[10, 20, 30]]]);
    let cells = r#"{"meta":{"name":"ten","unit":"cell","container":[10,10,10]},"episodes":[[[2,3,5]]]}"#;
    let options = ReadOptions { container: ContainerSize::new(1, 1, 1, 40).unwrap(), skip_bad: false };
    let set = dataset::read_json(cells.as_bytes(), &options).unwrap();
    assert_eq!(set.container, ContainerSize::new(10, 10, 10, 40).unwrap());
    assert_eq!(set.episode(0).unwrap().boxes[0].size_mm(), [80, 120, 200]);
    assert_eq!(set.episode(1), None);
}

#[test]
fn broken_json_says_where() {
    refuses(
        json(in_cm("[[[1, 2, 3], [4, 5").trim_end_matches('}')),
        "it is not an episode file, as seen in episode 0, box 1: EOF while parsing a list at line 1 column 95",
    );
    refuses(
        json(&in_cm("[[[1, 2, 3]], [[1, NaN, 3]]]")),
        "it is not an episode file, as seen in episode 1, box 0: expected value at line 1 column 97",
    );
    refuses(
        json(&in_cm("[[1, 2, 3]]")),
        "it is not an episode file, as seen in episode 0, box 0: invalid type: integer `1`, expected a box: a list \
         of its length, breadth and height at line 1 column 80",
    );
    refuses(
        json(&in_cm("[]").replace("cm", "inch")),
        "it is not an episode file, as seen before its episodes: unknown variant `inch`, expected one of `mm`, \
         `cm`, `cell` at line 1 column 37",
    );
    refuses(
        json(&in_cm("[]").replace("name", "nmae")),
        "it is not an episode file, as seen before its episodes: unknown field `nmae`, expected one of `name`, \
         `unit`, `container`, `optimum` at line 1 column 16",
    );
    refuses(
        json(r#"{"episodes": [[[1, 2, 3]]]}"#),
        "it is not an episode file, as seen in episode 1: missing field `meta` at line 1 column 27",
    );
    for text in ["", "[]", "{}", "null", "\u{feff}{}", "[[[[[[[[", "{\"meta\":{}}", "{\"meta\":1,\"meta\":2}"] {
        assert!(matches!(json(text), Err(Problem::Json(..))), "{text}");
    }
    assert!(matches!(json(&format!("{} 1", in_cm("[[[1, 2, 3]]]"))), Err(Problem::Json(..))));
}

#[test]
fn unusable_boxes_say_which() {
    let cases = [
        (
            "[[[1, 2, 3], [1, -2, 3]]]",
            "in episode 0, box 1: its breadth is -20 mm: it must be more than 0 and at most 10000 mm",
        ),
        (
            "[[[1, 2, 3]], [[1, 2, 0]]]",
            "in episode 1, box 0: its height is 0 mm: it must be more than 0 and at most 10000 mm",
        ),
        (
            "[[[1e9, 2, 3]]]",
            "in episode 0, box 0: its length is 10000000000 mm: it must be more than 0 and at most 10000 mm",
        ),
        ("[[[1, 2, \"3\"]]]", "in episode 0, box 0: its height is not a number"),
        ("[[[1, null, 3]]]", "in episode 0, box 0: its breadth is not a number"),
        ("[[[1, 2]]]", "in episode 0, box 0: a box has 3 sides and this one 2"),
        ("[[[1, 2, 3, 4]]]", "in episode 0, box 0: a box has 3 sides and this one 4"),
        ("[[[81, 2, 3]]]", "in episode 0, box 0: its 81 x 2 x 3 cells fit no container of 45 x 80 x 50 cells of 10 mm"),
        ("[[[1, 2, 3]], []]", "in episode 1: there is no box in it"),
        ("[]", "it has no usable episode"),
    ];
    for (episodes, expected) in cases {
        refuses(json(&in_cm(episodes)), expected);
    }
}

#[test]
fn containers_that_cannot_be() {
    let with = |container: &str| json(&in_cm("[[[1, 2, 3]]]").replace("[45, 80, 50]", container));
    refuses(
        with("[45.5, 80, 50]"),
        "its container is [455.0, 800.0, 500.0] mm: every side must be a whole number of cells of 10 mm (another \
         cell size may fit)",
    );
    refuses(
        with("[0, 80, 50]"),
        "its container cannot be: a container of 0 x 80 x 50 cells of 10 mm: sides must be 1 to 10000 cells of at \
         least 1 mm",
    );
    assert!(matches!(with("[400, 800, 50]"), Err(Problem::Container(_))), "one floor alone exceeds the grid");
    assert!(matches!(with("[-45, 80, 50]"), Err(Problem::ContainerSide(..))));
    assert!(matches!(with("[1e300, 80, 50]"), Err(Problem::ContainerSide(..))));
    assert!(matches!(with("[45, 80]"), Err(Problem::Json(..))));
}

#[test]
fn broken_csv_says_which_line() {
    let header = |rows: &str| csv(&format!("episode,l,b,h\n{rows}"));
    refuses(csv(""), "its first line is \"\" and must be \"episode,l,b,h\"");
    refuses(csv("l,b,h\n1,2,3\n"), "its first line is \"l,b,h\" and must be \"episode,l,b,h\"");
    refuses(csv("0,1,2,3\n"), "its first line is \"0,1,2,3\" and must be \"episode,l,b,h\"");
    refuses(header(""), "it has no usable episode");
    refuses(header("0,1,2,3\n0,1,NaN,3\n"), "in episode 0, box 1 (line 3): its breadth is not a number");
    refuses(header("0,1,2,3\n7,1,two,3\n"), "in episode 7, box 0 (line 3): its breadth is not a number");
    refuses(header("0,1,2\n"), "in episode 0, box 0 (line 2): a box has 3 sides and this one 2");
    refuses(
        header("first,1,2,3\n"),
        "in episode 0, box 0 (line 2): the episode is \"first\" and must be a whole number",
    );
    refuses(
        header("1,1,2,3\n2,1,2,3\n1,1,2,3\n"),
        "in episode 2, box 1 (line 4): episode 1 had ended: the lines of an episode must stand together, in rising order",
    );
    let set = csv("\u{feff}episode, l, b, h\r\n4, 100, 200, 300\r\n4,1,1,0.5\r\n\r\n9,10,10,10").unwrap();
    assert_eq!(sizes(&set), [vec![[100, 200, 300], [1, 1, 1]], vec![[10, 10, 10]]]);
    assert!(dataset::read_csv(b"episode,l,b,h\n0,\xff,2,3\n", "n", &ReadOptions::default()).is_err());
}

#[test]
fn skip_bad_counts_and_goes_on() {
    let text = in_cm(r#"[[[1, 2, 3], [1, "x", 3], [1, 2]], [], [[0, 1, 1]], [[99, 99, 99], [4, 5, 6]]]"#);
    let set = dataset::read_json(text.as_bytes(), &SKIP_BAD).unwrap();
    assert_eq!(sizes(&set), [[[10, 20, 30]], [[40, 50, 60]]]);
    assert_eq!(set.skipped, Skipped { boxes: 4, episodes: 2 });
    assert_eq!(set.episodes[1][0].id(), 0, "boxes are numbered from 0 all the same");
    let text = "episode,l,b,h\n0,1,2,3\nx,1,2,3\n1,0,0,0\n2,9,9,9,9\n2,5,5,5\n0,1,1,1\n";
    let set = dataset::read_csv(text.as_bytes(), "n", &SKIP_BAD).unwrap();
    assert_eq!(sizes(&set), [[[1, 2, 3]], [[5, 5, 5]]]);
    assert_eq!(set.skipped, Skipped { boxes: 4, episodes: 1 });
    assert!(matches!(dataset::read_json(in_cm("[[]]").as_bytes(), &SKIP_BAD), Err(Problem::NoEpisode)));
}

#[test]
fn a_file_error_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str| dataset::read(&folder.path().join(name), &ReadOptions::default());
    let FileError { path, problem } = read("boxes.txt").unwrap_err();
    assert_eq!(
        (path, problem.to_string().as_str()),
        (folder.path().join("boxes.txt"), "its name must end in .json or .csv")
    );
    assert!(matches!(read("missing.json").unwrap_err().problem, Problem::Io(_)));
    fs::create_dir(folder.path().join("folder.json")).unwrap();
    assert!(matches!(read("folder.json").unwrap_err().problem, Problem::Io(_)));
    let set = NAMED[0].generate(Split::Test, 1, 1).unwrap();
    assert!(matches!(dataset::write(&folder.path().join("set.xml"), &set).unwrap_err().problem, Problem::Ending));
    assert!(!folder.path().join("set.xml").exists());
    assert!(dataset::write(&folder.path().join("no/such/folder.json"), &set).is_err());
}

/// Every prefix and every single-bit change of a small valid file is read or refused, in both modes.
#[test]
fn no_damage_is_a_panic() {
    let json =
        br#"{"meta":{"name":"n","unit":"cm","container":[45,80,50],"optimum":2},"episodes":[[[1,2.5,3]],[[4,5,6]]]}"#;
    let csv = b"episode,l,b,h\n0,10,2.5,30\n1,40,50,60\n";
    for options in [ReadOptions::default(), SKIP_BAD] {
        let read = |bytes: &[u8]| {
            let _either_is_fine = dataset::read_json(bytes, &options);
            let _either_is_fine = dataset::read_csv(bytes, "n", &options);
        };
        for whole in [json.as_slice(), csv.as_slice()] {
            (0..=whole.len()).for_each(|end| read(&whole[..end]));
            for position in 0..whole.len() {
                for byte in 0..=255 {
                    let mut damaged = whole.to_vec();
                    damaged[position] = byte;
                    read(&damaged);
                }
            }
        }
    }
}
