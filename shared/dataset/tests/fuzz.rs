//! Whatever bytes an episode file holds, reading it ends with boxes or with one message.

#![expect(clippy::unwrap_used, reason = "a test that cannot make its files has failed")]

use dataset::{DataSet, Named, ReadOptions, read_csv, read_json, write_csv, write_json};
use packing::{ContainerSize, Split};
use proptest::prelude::*;

fn options(skip_bad: bool) -> ReadOptions {
    ReadOptions { container: ContainerSize::PAPER, skip_bad }
}

/// Both readers on the same bytes, strict and lenient.
fn read_all(bytes: &[u8]) {
    for skip_bad in [false, true] {
        let _ = read_json(bytes, &options(skip_bad)).map_err(|problem| problem.to_string());
        let _ = read_csv(bytes, "fuzzed", &options(skip_bad)).map_err(|problem| problem.to_string());
    }
}

/// One valid file of each kind, of one episode.
fn valid() -> [Vec<u8>; 2] {
    let set: DataSet = Named::find("ten").unwrap().generate(Split::Test, 1, 1).unwrap();
    let (mut json, mut csv) = (Vec::new(), Vec::new());
    write_json(&set, &mut json).unwrap();
    write_csv(&set, &mut csv).unwrap();
    [json, csv]
}

#[test]
fn every_truncation_and_every_flipped_byte_is_read_or_refused() {
    for file in valid() {
        assert!(!file.is_empty());
        for at in 0..file.len() {
            read_all(&file[..at]);
            for flip in [1, 0x80, 0xff] {
                let mut flipped = file.clone();
                flipped[at] ^= flip;
                read_all(&flipped);
            }
        }
    }
}

proptest! {
    #[test]
    fn no_bytes_make_a_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        read_all(&bytes);
    }

    #[test]
    fn nor_does_what_looks_like_a_file(text in r#"(\{"meta": ?\{("[a-z]{1,9}": ?[-0-9."a-z\[\], ]{0,12},?){0,4}\}, ?"episodes": ?[\[\]0-9., e+-]{0,80}\}|episode,l,b,h\n([-0-9.e+]{0,9}[,\n]){0,20})"#) {
        read_all(text.as_bytes());
    }
}
