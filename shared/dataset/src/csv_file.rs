//! Data sets as CSV.

use std::io::{self, Write};

use csv::{ByteRecord, ReaderBuilder};

use crate::set::{Builder, RawBox};
use crate::{BadBox, DataSet, Problem, ReadOptions};

const COLUMNS: [&str; 4] = ["episode", "l", "b", "h"];

/// Reads a data set called `name` from the bytes of a CSV file.
///
/// # Errors
/// [`Problem`] says what is wrong, in which episode, with which box and on which line.
pub fn read_csv(bytes: &[u8], name: &str, options: &ReadOptions) -> Result<DataSet, Problem> {
    let mut reader = ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(bytes);
    let header = reader.byte_headers().map_err(Problem::Csv)?;
    if !header.iter().eq(COLUMNS.map(str::as_bytes)) {
        let fields: Vec<_> = header.iter().map(String::from_utf8_lossy).collect();
        return Err(Problem::Columns { found: shorten(&fields.join(",")) });
    }
    let mut builder = Builder::new(name.to_owned(), options.container, None, options);
    let mut open = None;
    let mut record = ByteRecord::new();
    while reader.read_byte_record(&mut record).map_err(Problem::Csv)? {
        let line = record.position().map(csv::Position::line);
        let number = match episode_number(&record) {
            Ok(number) if open.is_some_and(|open| number < open) => Err(BadBox::EpisodeOver(number)),
            other => other,
        };
        if let Ok(number) = number
            && open != Some(number)
        {
            if open.is_some() {
                builder.end()?;
            }
            builder.begin(number);
            open = Some(number);
        }
        builder.push(number.map(|_| sides(&record)), 1.0, line)?;
    }
    if open.is_some() {
        builder.end()?;
    }
    builder.finish()
}

/// Writes a data set as CSV, in millimetres, its episodes counted from 0.
///
/// # Errors
/// Whatever `file` refuses.
pub fn write_csv(set: &DataSet, file: &mut impl Write) -> io::Result<()> {
    writeln!(file, "{}", COLUMNS.join(","))?;
    for (episode, boxes) in set.episodes.iter().enumerate() {
        for spec in boxes {
            let [length, breadth, height] = spec.size_mm();
            writeln!(file, "{episode},{length},{breadth},{height}")?;
        }
    }
    Ok(())
}

fn episode_number(record: &ByteRecord) -> Result<u64, BadBox> {
    let field = String::from_utf8_lossy(record.get(0).unwrap_or_default());
    field.parse().map_err(|_| BadBox::EpisodeNumber(shorten(&field)))
}

fn sides(record: &ByteRecord) -> RawBox {
    let mut raw = RawBox::default();
    for field in record.iter().skip(1) {
        raw.push(std::str::from_utf8(field).ok().and_then(|text| text.parse().ok()).unwrap_or(f64::NAN));
    }
    raw
}

/// The beginning of a text, short enough for a message.
fn shorten(text: &str) -> String {
    const CHARS_MAX: usize = 60;
    match text.char_indices().nth(CHARS_MAX) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
