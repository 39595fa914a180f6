//! Grids of any size into 144 numbers each: disjoint pooling, before and after a box.

use std::ops::Range;

use packing::{Extent, Grid, Placement};

/// Fields along the containers' length.
pub const FIELD_ROWS: usize = 9;
/// Fields along the row of containers.
pub const FIELD_COLUMNS: usize = 16;
/// Fields of a grid: the paper's 144.
pub const FIELDS: usize = FIELD_ROWS * FIELD_COLUMNS;

/// What is known of one field's heights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Field {
    /// Cells of the field; 0 where a grid is narrower than its fields.
    pub(crate) cells: u32,
    /// Sum of the heights [cells].
    pub(crate) sum: u32,
    /// Largest height [cells].
    pub(crate) highest: u16,
    /// Smallest height [cells].
    pub(crate) lowest: u16,
    /// Cells that have it.
    pub(crate) at_lowest: u32,
}

/// The `L x (T*B)` grid of all containers side by side, pooled into 9 x 16 disjoint fields.
///
/// Field `r` of `n` covers the cells `r*size/n .. (r+1)*size/n` along its axis, so that every cell of any grid
/// lies in exactly one field. A grid with fewer cells than fields leaves some fields empty: they count as zero.
/// Containers stand in the order of their slots. Paper: "State definition".
#[derive(Clone, Debug, Default)]
pub(crate) struct Pool {
    length: usize,
    breadth: usize,
    columns: usize,
    fields: Vec<Field>,
}

/// First cell of each of `parts` disjoint parts of `cells`, for part `part`.
fn part_start(part: usize, parts: usize, cells: usize) -> usize {
    part * cells / parts
}

/// The part in which a cell lies.
fn part_of(cell: usize, parts: usize, cells: usize) -> usize {
    // The largest part whose start is not behind the cell: part*cells/parts <= cell.
    ((cell + 1) * parts - 1) / cells
}

impl Pool {
    /// Pools the present grid.
    pub(crate) fn refresh(&mut self, grid: &Grid) {
        self.length = usize::from(grid.size().length());
        self.breadth = usize::from(grid.size().breadth());
        self.columns = self.breadth * grid.slots().len();
        self.fields.clear();
        for row in 0..FIELD_ROWS {
            for column in 0..FIELD_COLUMNS {
                let (rows, columns) = (self.rows(row), self.columns(column));
                self.fields.push(self.pool(grid, rows, columns));
            }
        }
    }

    /// The present fields, row by row.
    pub(crate) fn fields(&self) -> &[Field] {
        &self.fields
    }

    /// The field in which the first cell of a placement lies.
    pub(crate) fn field_of(&self, placement: Placement) -> usize {
        let column = usize::from(placement.slot) * self.breadth + usize::from(placement.j);
        let row = part_of(usize::from(placement.i), FIELD_ROWS, self.length);
        row * FIELD_COLUMNS + part_of(column, FIELD_COLUMNS, self.columns)
    }

    /// Calls `update` with every field that a box of `turned` extent changes, and what it is with the box there.
    pub(crate) fn for_changed(
        &self,
        grid: &Grid,
        turned: Extent,
        placement: Placement,
        mut update: impl FnMut(usize, Field),
    ) {
        let first_row = usize::from(placement.i);
        let end_row = first_row + usize::from(turned.length);
        let first_column = usize::from(placement.slot) * self.breadth + usize::from(placement.j);
        let end_column = first_column + usize::from(turned.breadth);
        let top = placement.base + turned.height;
        let field_rows = part_of(first_row, FIELD_ROWS, self.length)..=part_of(end_row - 1, FIELD_ROWS, self.length);
        for row in field_rows {
            let rows = self.rows(row);
            let covered_rows = rows.start.max(first_row)..rows.end.min(end_row);
            let field_columns = part_of(first_column, FIELD_COLUMNS, self.columns)
                ..=part_of(end_column - 1, FIELD_COLUMNS, self.columns);
            for column in field_columns {
                let columns = self.columns(column);
                let covered_columns = columns.start.max(first_column)..columns.end.min(end_column);
                let covered = (covered_rows.len() * covered_columns.len()) as u32;
                if covered == 0 {
                    continue;
                }
                let index = row * FIELD_COLUMNS + column;
                let mut field = self.fields[index];
                // All cells under a base have the base's height, so each rises by the box's.
                field.sum += covered * u32::from(turned.height);
                field.highest = field.highest.max(top);
                // Unless the box covers all of the lowest cells, one of them stays.
                if field.lowest == placement.base && field.at_lowest <= covered {
                    let around = [
                        (rows.start..covered_rows.start, columns.clone()),
                        (covered_rows.end..rows.end, columns.clone()),
                        (covered_rows.clone(), columns.start..covered_columns.start),
                        (covered_rows.clone(), covered_columns.end..columns.end),
                    ];
                    let lowest_around = around.into_iter().map(|(rows, columns)| self.lowest(grid, rows, columns));
                    field.lowest = lowest_around.fold(top, u16::min);
                }
                update(index, field);
            }
        }
    }

    fn rows(&self, row: usize) -> Range<usize> {
        part_start(row, FIELD_ROWS, self.length)..part_start(row + 1, FIELD_ROWS, self.length)
    }

    fn columns(&self, column: usize) -> Range<usize> {
        part_start(column, FIELD_COLUMNS, self.columns)..part_start(column + 1, FIELD_COLUMNS, self.columns)
    }

    fn pool(&self, grid: &Grid, rows: Range<usize>, columns: Range<usize>) -> Field {
        if rows.is_empty() || columns.is_empty() {
            return Field::default();
        }
        let cells = (rows.len() * columns.len()) as u32;
        let mut field = Field { cells, sum: 0, highest: 0, lowest: u16::MAX, at_lowest: 0 };
        self.for_runs(grid, rows, columns, |height, cells| {
            field.sum += u32::from(height) * u32::from(cells);
            field.highest = field.highest.max(height);
            if height < field.lowest {
                (field.lowest, field.at_lowest) = (height, 0);
            }
            field.at_lowest += if height == field.lowest { u32::from(cells) } else { 0 };
        });
        field
    }

    /// The smallest height in an area, or the largest number if the area is empty.
    fn lowest(&self, grid: &Grid, rows: Range<usize>, columns: Range<usize>) -> u16 {
        let mut lowest = u16::MAX;
        self.for_runs(grid, rows, columns, |height, _| lowest = lowest.min(height));
        lowest
    }

    /// Calls `each` with every run of equal heights in an area of the long grid: the height and how many cells have it.
    fn for_runs(&self, grid: &Grid, rows: Range<usize>, columns: Range<usize>, mut each: impl FnMut(u16, u16)) {
        let mut start = columns.start;
        while start < columns.end {
            let slot = start / self.breadth;
            let end = columns.end.min((slot + 1) * self.breadth);
            let surface = grid.slots()[slot].surface();
            let within = (start - slot * self.breadth) as u16..(end - slot * self.breadth) as u16;
            for row in rows.clone() {
                surface.runs_along_j(row as u16, within.clone()).for_each(|(height, cells)| each(height, cells));
            }
            start = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use packing::ContainerSize;

    use super::*;

    #[test]
    fn every_cell_lies_in_exactly_one_field() {
        for parts in [FIELD_ROWS, FIELD_COLUMNS] {
            for cells in 1..200 {
                for cell in 0..cells {
                    let part = part_of(cell, parts, cells);
                    let range = part_start(part, parts, cells)..part_start(part + 1, parts, cells);
                    assert!(range.contains(&cell), "cell {cell} of {cells}, part {part} of {parts}: {range:?}");
                }
                assert_eq!((part_start(0, parts, cells), part_start(parts, parts, cells)), (0, cells));
            }
        }
    }

    /// Paper: a 45 x 1280 grid has 144 fields of 5 x 80 cells.
    #[test]
    fn the_papers_fields() {
        let mut pool = Pool::default();
        pool.refresh(&Grid::new(ContainerSize::PAPER, 16).unwrap());
        assert_eq!(pool.fields().len(), 144);
        assert!(pool.fields().iter().all(|field| field.cells == 5 * 80));
        assert_eq!((pool.rows(8), pool.columns(15)), (40..45, 1200..1280));
    }
}
