//! Columnar storage for entities that are logged every frame, without an array per row.

use std::sync::Arc;

use super::{
    instant::{Instant, STAGE},
    normals::Float3,
};
use crate::sdk::{
    ChunkComponents, ComponentDescriptor, EntityPath, RowId, TimeColumn,
    arrow::{
        array::{
            ArrayRef, FixedSizeListArray, Float32Array, Float64Array, ListArray, StringArray, UInt16Array, UInt32Array,
        },
        buffer::OffsetBuffer,
        datatypes::{DataType, Field},
        error::ArrowError,
    },
};

/// A chunk is full at this many bytes of values, or this many rows: the sizes to which the viewer's store compacts
/// chunks.
const CHUNK_BYTES: usize = 384 << 10;
const CHUNK_ROWS: usize = 4096;

/// The value of one component in a row.
#[derive(Clone, Copy, Debug)]
pub enum Cell<'a> {
    /// Positions or directions.
    Vectors(&'a [Float3]),
    /// Rotations: x, y, z, w.
    Quaternions(&'a [[f32; 4]]),
    /// Texture coordinates.
    Places(&'a [[f32; 2]]),
    /// Scalars of a plot.
    Scalars(&'a [f64]),
    /// Scalars of vertices.
    Floats(&'a [f32]),
    /// Packed colours.
    Colors(&'a [u32]),
    /// Class ids of an annotation context.
    Classes(&'a [u16]),
    /// Line segments.
    Segments(&'a [[Float3; 2]]),
    /// Vertex indices of triangles.
    Triangles(&'a [[u32; 3]]),
    /// Vertex indices.
    Indices(&'a [u32]),
    /// Line strips.
    Strips(&'a [Vec<Float3>]),
    /// Labels.
    Texts(&'a [String]),
    /// Strings from a small fixed set.
    Names(&'a [&'static str]),
}

/// The rows of an entity that have not been sent, all with the same components.
pub(super) struct Columns {
    pub entity: EntityPath,
    ids: Vec<RowId>,
    /// Step numbers; stage numbers if there are no times.
    steps: Vec<i64>,
    nanoseconds: Vec<i64>,
    columns: Vec<Column>,
    /// Number of rows already shown, see [`Columns::show`].
    shown: usize,
}

/// The parts from which a chunk is built.
pub(super) type ChunkParts = (Vec<RowId>, Vec<TimeColumn>, ChunkComponents);

struct Column {
    descriptor: ComponentDescriptor,
    values: Values,
    lengths: Vec<usize>,
}

enum Values {
    Empty,
    Vectors(Vec<Float3>),
    Quaternions(Vec<[f32; 4]>),
    Places(Vec<[f32; 2]>),
    Scalars(Vec<f64>),
    Floats(Vec<f32>),
    Colors(Vec<u32>),
    Classes(Vec<u16>),
    Segments(Vec<[Float3; 2]>),
    Triangles(Vec<[u32; 3]>),
    Indices(Vec<u32>),
    Strips(Vec<Vec<Float3>>),
    Texts(Vec<String>),
    Names(Vec<&'static str>),
}

impl Columns {
    pub fn new(entity: &str, descriptors: Vec<ComponentDescriptor>) -> Columns {
        let column = |descriptor| Column { descriptor, values: Values::Empty, lengths: Vec::new() };
        Columns {
            entity: EntityPath::from(entity),
            ids: Vec::new(),
            steps: Vec::new(),
            nanoseconds: Vec::new(),
            columns: descriptors.into_iter().map(column).collect(),
            shown: 0,
        }
    }

    /// Adds a row, one cell per component.
    pub fn push(&mut self, id: RowId, at: Instant, stage: Option<u64>, cells: &[Cell<'_>]) {
        self.ids.push(id);
        match stage {
            Some(stage) => self.steps.push(stage as i64),
            None => {
                self.steps.push(at.step as i64);
                self.nanoseconds.push(at.nanoseconds());
            }
        }
        for (column, cell) in self.columns.iter_mut().zip(cells) {
            column.lengths.push(column.values.extend(*cell));
        }
    }

    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Whether there are enough bytes for a full chunk.
    pub fn is_full(&self) -> bool {
        self.columns.iter().map(|column| column.values.bytes()).sum::<usize>() >= CHUNK_BYTES
    }

    /// Whether there are enough rows for a full chunk.
    pub fn is_long(&self) -> bool {
        self.ids.len() >= CHUNK_ROWS
    }

    /// Takes all rows, in the form of a chunk.
    pub fn take(&mut self) -> Result<ChunkParts, ArrowError> {
        let fresh = Columns {
            entity: self.entity.clone(),
            ids: Vec::new(),
            steps: Vec::new(),
            nanoseconds: Vec::new(),
            columns: self.columns.iter().map(Column::fresh).collect(),
            shown: 0,
        };
        std::mem::replace(self, fresh).into_parts()
    }

    /// Copies the rows that have not been shown yet, if there are any; they remain to be taken.
    pub fn show(&mut self) -> Option<Result<ChunkParts, ArrowError>> {
        let first = std::mem::replace(&mut self.shown, self.ids.len());
        let rest = Columns {
            entity: self.entity.clone(),
            ids: self.ids[first..].to_vec(),
            steps: self.steps[first..].to_vec(),
            nanoseconds: self.nanoseconds.get(first..).unwrap_or_default().to_vec(),
            columns: self.columns.iter().map(|column| column.rows_from(first)).collect(),
            shown: 0,
        };
        (!rest.is_empty()).then(|| rest.into_parts())
    }

    fn into_parts(self) -> Result<ChunkParts, ArrowError> {
        let mut components = Vec::with_capacity(self.columns.len());
        for Column { descriptor, values, lengths } in self.columns {
            let values = values.into_array()?;
            let field = Field::new_list_field(values.data_type().clone(), true);
            let offsets = OffsetBuffer::from_lengths(lengths);
            components.push((descriptor, ListArray::try_new(field.into(), offsets, values, None)?));
        }
        let timelines = if self.nanoseconds.is_empty() {
            vec![TimeColumn::new_sequence(STAGE, self.steps)]
        } else {
            vec![
                TimeColumn::new_sequence("step", self.steps),
                TimeColumn::new_duration_nanos("sim_time", self.nanoseconds),
            ]
        };
        Ok((self.ids, timelines, components.into_iter().collect()))
    }
}

impl Column {
    /// An empty column with the same capacity.
    fn fresh(&self) -> Column {
        let (values, lengths) = (self.values.with_capacity(), Vec::with_capacity(self.lengths.len()));
        Column { descriptor: self.descriptor.clone(), values, lengths }
    }

    /// A copy of the rows from `first` on.
    fn rows_from(&self, first: usize) -> Column {
        let before = self.lengths[..first].iter().sum();
        let (values, lengths) = (self.values.values_from(before), self.lengths[first..].to_vec());
        Column { descriptor: self.descriptor.clone(), values, lengths }
    }
}

impl Values {
    /// Appends a cell; returns its length.
    fn extend(&mut self, cell: Cell<'_>) -> usize {
        match (self, cell) {
            (Values::Vectors(values), Cell::Vectors(cell)) => append(values, cell),
            (Values::Quaternions(values), Cell::Quaternions(cell)) => append(values, cell),
            (Values::Places(values), Cell::Places(cell)) => append(values, cell),
            (Values::Scalars(values), Cell::Scalars(cell)) => append(values, cell),
            (Values::Floats(values), Cell::Floats(cell)) => append(values, cell),
            (Values::Colors(values), Cell::Colors(cell)) => append(values, cell),
            (Values::Classes(values), Cell::Classes(cell)) => append(values, cell),
            (Values::Segments(values), Cell::Segments(cell)) => append(values, cell),
            (Values::Triangles(values), Cell::Triangles(cell)) => append(values, cell),
            (Values::Indices(values), Cell::Indices(cell)) => append(values, cell),
            (Values::Strips(values), Cell::Strips(cell)) => append(values, cell),
            (Values::Texts(values), Cell::Texts(cell)) => append(values, cell),
            (Values::Names(values), Cell::Names(cell)) => append(values, cell),
            (values, cell) => {
                // the first row determines the type of the column
                *values = match cell {
                    Cell::Vectors(cell) => Values::Vectors(cell.to_vec()),
                    Cell::Quaternions(cell) => Values::Quaternions(cell.to_vec()),
                    Cell::Places(cell) => Values::Places(cell.to_vec()),
                    Cell::Scalars(cell) => Values::Scalars(cell.to_vec()),
                    Cell::Floats(cell) => Values::Floats(cell.to_vec()),
                    Cell::Colors(cell) => Values::Colors(cell.to_vec()),
                    Cell::Classes(cell) => Values::Classes(cell.to_vec()),
                    Cell::Segments(cell) => Values::Segments(cell.to_vec()),
                    Cell::Triangles(cell) => Values::Triangles(cell.to_vec()),
                    Cell::Indices(cell) => Values::Indices(cell.to_vec()),
                    Cell::Strips(cell) => Values::Strips(cell.to_vec()),
                    Cell::Texts(cell) => Values::Texts(cell.to_vec()),
                    Cell::Names(cell) => Values::Names(cell.to_vec()),
                };
                cell.len()
            }
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Values::Empty => 0,
            Values::Vectors(values) => size_of_val(values.as_slice()),
            Values::Quaternions(values) => size_of_val(values.as_slice()),
            Values::Places(values) => size_of_val(values.as_slice()),
            Values::Scalars(values) => size_of_val(values.as_slice()),
            Values::Floats(values) => size_of_val(values.as_slice()),
            Values::Colors(values) => size_of_val(values.as_slice()),
            Values::Classes(values) => size_of_val(values.as_slice()),
            Values::Segments(values) => size_of_val(values.as_slice()),
            Values::Triangles(values) => size_of_val(values.as_slice()),
            Values::Indices(values) => size_of_val(values.as_slice()),
            Values::Strips(values) => values.iter().map(|strip| size_of_val(strip.as_slice())).sum(),
            Values::Texts(values) => size_of_val(values.as_slice()),
            Values::Names(values) => size_of_val(values.as_slice()),
        }
    }

    /// Empty storage with the same capacity.
    fn with_capacity(&self) -> Values {
        match self {
            Values::Empty => Values::Empty,
            Values::Vectors(values) => Values::Vectors(Vec::with_capacity(values.len())),
            Values::Quaternions(values) => Values::Quaternions(Vec::with_capacity(values.len())),
            Values::Places(values) => Values::Places(Vec::with_capacity(values.len())),
            Values::Scalars(values) => Values::Scalars(Vec::with_capacity(values.len())),
            Values::Floats(values) => Values::Floats(Vec::with_capacity(values.len())),
            Values::Colors(values) => Values::Colors(Vec::with_capacity(values.len())),
            Values::Classes(values) => Values::Classes(Vec::with_capacity(values.len())),
            Values::Segments(values) => Values::Segments(Vec::with_capacity(values.len())),
            Values::Triangles(values) => Values::Triangles(Vec::with_capacity(values.len())),
            Values::Indices(values) => Values::Indices(Vec::with_capacity(values.len())),
            Values::Strips(values) => Values::Strips(Vec::with_capacity(values.len())),
            Values::Texts(values) => Values::Texts(Vec::with_capacity(values.len())),
            Values::Names(values) => Values::Names(Vec::with_capacity(values.len())),
        }
    }

    /// A copy of the values from `first` on.
    fn values_from(&self, first: usize) -> Values {
        match self {
            Values::Empty => Values::Empty,
            Values::Vectors(values) => Values::Vectors(values[first..].to_vec()),
            Values::Quaternions(values) => Values::Quaternions(values[first..].to_vec()),
            Values::Places(values) => Values::Places(values[first..].to_vec()),
            Values::Scalars(values) => Values::Scalars(values[first..].to_vec()),
            Values::Floats(values) => Values::Floats(values[first..].to_vec()),
            Values::Colors(values) => Values::Colors(values[first..].to_vec()),
            Values::Classes(values) => Values::Classes(values[first..].to_vec()),
            Values::Segments(values) => Values::Segments(values[first..].to_vec()),
            Values::Triangles(values) => Values::Triangles(values[first..].to_vec()),
            Values::Indices(values) => Values::Indices(values[first..].to_vec()),
            Values::Strips(values) => Values::Strips(values[first..].to_vec()),
            Values::Texts(values) => Values::Texts(values[first..].to_vec()),
            Values::Names(values) => Values::Names(values[first..].to_vec()),
        }
    }

    fn into_array(self) -> Result<ArrayRef, ArrowError> {
        Ok(match self {
            Values::Empty => Arc::new(Float64Array::from(Vec::<f64>::new())),
            Values::Vectors(values) => tuples(values)?,
            Values::Quaternions(values) => tuples(values)?,
            Values::Places(values) => tuples(values)?,
            Values::Scalars(values) => Arc::new(Float64Array::from(values)),
            Values::Floats(values) => Arc::new(Float32Array::from(values)),
            Values::Colors(values) => Arc::new(UInt32Array::from(values)),
            Values::Classes(values) => Arc::new(UInt16Array::from(values)),
            Values::Segments(values) => strips(values.iter().map(|_| 2), values.as_flattened().to_vec())?,
            Values::Strips(values) => strips(values.iter().map(Vec::len), values.concat())?,
            Values::Triangles(values) => {
                let indices = Arc::new(UInt32Array::from(values.into_flattened()));
                let item = Field::new("item", DataType::UInt32, false);
                Arc::new(FixedSizeListArray::try_new(item.into(), 3, indices, None)?)
            }
            Values::Indices(values) => Arc::new(UInt32Array::from(values)),
            Values::Texts(values) => Arc::new(StringArray::from(values)),
            Values::Names(values) => Arc::new(StringArray::from(values)),
        })
    }
}

fn tuples<const N: usize>(values: Vec<[f32; N]>) -> Result<ArrayRef, ArrowError> {
    let coordinates = Arc::new(Float32Array::from(values.into_flattened()));
    let item = Field::new("item", DataType::Float32, false);
    Ok(Arc::new(FixedSizeListArray::try_new(item.into(), N as i32, coordinates, None)?))
}

/// Line strips of the given lengths.
fn strips(lengths: impl Iterator<Item = usize>, points: Vec<Float3>) -> Result<ArrayRef, ArrowError> {
    let points = tuples(points)?;
    let item = Field::new("item", points.data_type().clone(), false);
    Ok(Arc::new(ListArray::try_new(item.into(), OffsetBuffer::from_lengths(lengths), points, None)?))
}

fn append<T: Clone>(values: &mut Vec<T>, cell: &[T]) -> usize {
    values.extend_from_slice(cell);
    cell.len()
}

impl Cell<'_> {
    fn len(&self) -> usize {
        match self {
            Cell::Vectors(cell) => cell.len(),
            Cell::Quaternions(cell) => cell.len(),
            Cell::Places(cell) => cell.len(),
            Cell::Scalars(cell) => cell.len(),
            Cell::Floats(cell) => cell.len(),
            Cell::Colors(cell) => cell.len(),
            Cell::Classes(cell) => cell.len(),
            Cell::Segments(cell) => cell.len(),
            Cell::Triangles(cell) => cell.len(),
            Cell::Indices(cell) => cell.len(),
            Cell::Strips(cell) => cell.len(),
            Cell::Texts(cell) => cell.len(),
            Cell::Names(cell) => cell.len(),
        }
    }
}
