//! Columnar storage for entities that are logged every frame, without an array per row.

use std::{any::Any, sync::Arc};

use super::{
    contract::{SIM_TIME, STAGE, STEP},
    extract::Float3,
    instant::Instant,
};
use crate::sdk::{
    ChunkComponents, ComponentDescriptor, EntityPath, RowId, TimeColumn,
    arrow::{
        array::{
            ArrayRef, FixedSizeListArray, Float32Array, Float64Array, ListArray, StringArray, UInt16Array, UInt32Array,
            UInt64Array,
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

/// A type of the values of a component.
pub trait Element: Clone + PartialEq + Send + 'static {
    /// The values as an array.
    ///
    /// # Errors
    /// None is known to occur.
    fn array(values: Vec<Self>) -> Result<ArrayRef, ArrowError>;

    /// Size of the values [bytes].
    fn bytes(values: &[Self]) -> usize {
        size_of_val(values)
    }
}

macro_rules! elements {
    ($($(#[$about:meta])* $Type:ty: $values:ident => $array:expr;)*) => {
        $($(#[$about])* impl Element for $Type {
            fn array($values: Vec<$Type>) -> Result<ArrayRef, ArrowError> {
                Ok($array)
            }
        })*
    };
}

elements! {
    /// Scalars of a plot.
    f64: values => Arc::new(Float64Array::from(values));
    /// Scalars of vertices.
    f32: values => Arc::new(Float32Array::from(values));
    /// Packed colours, or indices.
    u32: values => Arc::new(UInt32Array::from(values));
    /// Checksums.
    u64: values => Arc::new(UInt64Array::from(values));
    /// Class ids of an annotation context.
    u16: values => Arc::new(UInt16Array::from(values));
    /// Texture coordinates.
    [f32; 2]: values => tuples(values)?;
    /// Positions or directions.
    Float3: values => tuples(values)?;
    /// Rotations: x, y, z, w.
    [f32; 4]: values => tuples(values)?;
    /// Line segments.
    [Float3; 2]: values => strips(values.iter().map(|_| 2), values.as_flattened().to_vec())?;
    /// Line segments in a plane.
    [[f32; 2]; 2]: values => strips(values.iter().map(|_| 2), values.as_flattened().to_vec())?;
    /// Labels.
    String: values => Arc::new(StringArray::from(values));
    /// Strings from a small fixed set.
    &'static str: values => Arc::new(StringArray::from(values));
}

/// Vertex indices of triangles.
impl Element for [u32; 3] {
    fn array(values: Vec<[u32; 3]>) -> Result<ArrayRef, ArrowError> {
        let indices = Arc::new(UInt32Array::from(values.into_flattened()));
        let item = Field::new("item", DataType::UInt32, false);
        Ok(Arc::new(FixedSizeListArray::try_new(item.into(), 3, indices, None)?))
    }
}

/// Line strips.
impl Element for Vec<Float3> {
    fn array(values: Vec<Vec<Float3>>) -> Result<ArrayRef, ArrowError> {
        strips(values.iter().map(Vec::len), values.concat())
    }

    fn bytes(values: &[Vec<Float3>]) -> usize {
        values.iter().map(|strip| size_of_val(strip.as_slice())).sum()
    }
}

fn tuples<const N: usize>(values: Vec<[f32; N]>) -> Result<ArrayRef, ArrowError> {
    let coordinates = Arc::new(Float32Array::from(values.into_flattened()));
    let item = Field::new("item", DataType::Float32, false);
    Ok(Arc::new(FixedSizeListArray::try_new(item.into(), N as i32, coordinates, None)?))
}

/// Line strips of the given lengths.
fn strips<const N: usize>(lengths: impl Iterator<Item = usize>, points: Vec<[f32; N]>) -> Result<ArrayRef, ArrowError> {
    let points = tuples(points)?;
    let item = Field::new("item", points.data_type().clone(), false);
    Ok(Arc::new(ListArray::try_new(item.into(), OffsetBuffer::from_lengths(lengths), points, None)?))
}

/// The values of one component in a row.
pub trait Cell {
    /// Appends them to a column of the same type, which they create if there is none; returns their number.
    fn append(&self, column: &mut Option<Box<dyn Values>>) -> usize;

    /// Whether they are the last `count` values of a column of the same type; one that is not there has none.
    fn ends(&self, column: &mut Option<Box<dyn Values>>, count: usize) -> bool;
}

impl<T: Element> Cell for Vec<T> {
    fn append(&self, column: &mut Option<Box<dyn Values>>) -> usize {
        append(self, column)
    }

    fn ends(&self, column: &mut Option<Box<dyn Values>>, count: usize) -> bool {
        ends(self, column, count)
    }
}

impl<T: Element, const N: usize> Cell for [T; N] {
    fn append(&self, column: &mut Option<Box<dyn Values>>) -> usize {
        append(self, column)
    }

    fn ends(&self, column: &mut Option<Box<dyn Values>>, count: usize) -> bool {
        ends(self, column, count)
    }
}

fn append<T: Element>(cell: &[T], column: &mut Option<Box<dyn Values>>) -> usize {
    let values = column.get_or_insert_with(|| Box::new(Vec::<T>::new()));
    // a column has values of one type, which is that of its component
    if let Some(values) = values.as_any().downcast_mut::<Vec<T>>() {
        values.extend_from_slice(cell);
    }
    cell.len()
}

fn ends<T: Element>(cell: &[T], column: &mut Option<Box<dyn Values>>, count: usize) -> bool {
    match column.as_mut().and_then(|values| values.as_any().downcast_mut::<Vec<T>>()) {
        Some(values) => *cell == values[values.len() - count..],
        None => cell.is_empty(),
    }
}

/// The values of a column, of any type.
pub trait Values: Send {
    /// For a downcast to a vector of the type.
    fn as_any(&mut self) -> &mut dyn Any;
    /// Their size [bytes].
    fn bytes(&self) -> usize;
    /// A copy of the values from `first` on.
    fn values_from(&self, first: usize) -> Box<dyn Values>;
    /// The values as an array.
    ///
    /// # Errors
    /// None is known to occur.
    fn array(self: Box<Self>) -> Result<ArrayRef, ArrowError>;
}

impl<T: Element> Values for Vec<T> {
    fn as_any(&mut self) -> &mut dyn Any {
        self
    }

    fn bytes(&self) -> usize {
        T::bytes(self)
    }

    fn values_from(&self, first: usize) -> Box<dyn Values> {
        Box::new(self[first..].to_vec())
    }

    fn array(self: Box<Self>) -> Result<ArrayRef, ArrowError> {
        T::array(*self)
    }
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
    /// `None` before the first row.
    values: Option<Box<dyn Values>>,
    lengths: Vec<usize>,
    /// The values of the last row that was taken, and their number.
    taken: (Option<Box<dyn Values>>, usize),
}

impl Columns {
    pub fn new(entity: &str, descriptors: Vec<ComponentDescriptor>) -> Columns {
        let column = |descriptor| Column { descriptor, values: None, lengths: Vec::new(), taken: (None, 0) };
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
    pub fn push(&mut self, id: RowId, at: Instant, stage: Option<u64>, cells: &[&dyn Cell]) {
        self.ids.push(id);
        match stage {
            Some(stage) => self.steps.push(stage as i64),
            None => {
                self.steps.push(at.step as i64);
                self.nanoseconds.push(at.nanoseconds());
            }
        }
        for (column, cell) in self.columns.iter_mut().zip(cells) {
            column.lengths.push(cell.append(&mut column.values));
        }
    }

    /// Whether cells, one per component, differ from those of the last row, whether or not that has been taken. The cells
    /// before the first row are empty.
    pub fn has_changed(&mut self, cells: &[&dyn Cell]) -> bool {
        let is_same = |(column, cell): (&mut Column, &&dyn Cell)| match column.lengths.last() {
            Some(&count) => cell.ends(&mut column.values, count),
            None => cell.ends(&mut column.taken.0, column.taken.1),
        };
        !self.columns.iter_mut().zip(cells).all(is_same)
    }

    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// Whether there are enough bytes for a full chunk.
    pub fn is_full(&self) -> bool {
        let bytes = |column: &Column| column.values.as_ref().map_or(0, |values| values.bytes());
        self.columns.iter().map(bytes).sum::<usize>() >= CHUNK_BYTES
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
            columns: self.columns.iter_mut().map(Column::fresh).collect(),
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
        for Column { descriptor, values, lengths, .. } in self.columns {
            let values = values.map_or_else(|| f64::array(Vec::new()), |values| values.array())?;
            let field = Field::new_list_field(values.data_type().clone(), true);
            let offsets = OffsetBuffer::from_lengths(lengths);
            components.push((descriptor, ListArray::try_new(field.into(), offsets, values, None)?));
        }
        let timelines = if self.nanoseconds.is_empty() {
            vec![TimeColumn::new_sequence(STAGE, self.steps)]
        } else {
            vec![TimeColumn::new_sequence(STEP, self.steps), TimeColumn::new_duration_nanos(SIM_TIME, self.nanoseconds)]
        };
        Ok((self.ids, timelines, components.into_iter().collect()))
    }
}

impl Column {
    /// The column after its rows are taken.
    fn fresh(&mut self) -> Column {
        let taken = match self.lengths.split_last() {
            Some((&count, before)) => {
                let first = before.iter().sum();
                (self.values.as_ref().map(|values| values.values_from(first)), count)
            }
            None => std::mem::take(&mut self.taken),
        };
        Column { descriptor: self.descriptor.clone(), values: None, lengths: Vec::new(), taken }
    }

    /// A copy of the rows from `first` on.
    fn rows_from(&self, first: usize) -> Column {
        let before = self.lengths[..first].iter().sum();
        Column {
            descriptor: self.descriptor.clone(),
            values: self.values.as_ref().map(|values| values.values_from(before)),
            lengths: self.lengths[first..].to_vec(),
            taken: (None, 0),
        }
    }
}
