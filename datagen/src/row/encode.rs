//! Encodes examples as Arrow columns.

use super::column::{Column, Content, columns};
use super::example::{Example, ExampleGenerator};
use super::schema::{image_fields, list_item, schema};
use crate::error::Result;
use arrow_array::{
    ArrayRef, BinaryArray, FixedSizeListArray, Float32Array, Float64Array, Int64Array, RecordBatch,
    StringArray, StructArray, UInt64Array,
};
use arrow_schema::DataType;
use std::sync::Arc;

/// Encodes examples as rows.
pub fn encode(generator: &ExampleGenerator<'_>, examples: &[Example]) -> Result<RecordBatch> {
    let columns = columns(generator.config());
    let arrays = columns.iter().map(|column| array(column, generator, examples)).collect::<Result<_>>()?;
    Ok(RecordBatch::try_new(Arc::new(schema(generator.config())), arrays)?)
}

fn array(column: &Column, generator: &ExampleGenerator<'_>, examples: &[Example]) -> Result<ArrayRef> {
    let list = |item: DataType, length: u16, values: ArrayRef| {
        FixedSizeListArray::try_new(list_item(item), i32::from(length), values, None)
    };
    Ok(match &column.content {
        Content::Image(view, suffix) => {
            let bytes = BinaryArray::from_iter_values(examples.iter().map(|e| &e.images[*view]));
            let name = &generator.config().name;
            let path = examples.iter().map(|e| format!("{name}/{:08}{suffix}.png", e.index));
            let path = StringArray::from_iter_values(path);
            Arc::new(StructArray::try_new(image_fields(), vec![Arc::new(bytes), Arc::new(path)], None)?)
        }
        Content::Count(extract) => {
            Arc::new(UInt64Array::from_iter_values(examples.iter().map(|e| extract(generator, e))))
        }
        Content::Class(_, extract) => {
            Arc::new(Int64Array::from_iter_values(examples.iter().map(|e| i64::from(extract(generator, e)))))
        }
        Content::Text(extract) => {
            let texts = examples.iter().map(|e| extract(generator, e)).collect::<Result<Vec<_>>>()?;
            Arc::new(StringArray::from_iter_values(texts))
        }
        Content::Doubles(length, extract) => {
            let values = Float64Array::from_iter_values(examples.iter().flat_map(|e| extract(generator, e)));
            Arc::new(list(DataType::Float64, *length, Arc::new(values))?)
        }
        Content::Floats(length, extract) => {
            let values = Float32Array::from_iter_values(examples.iter().flat_map(|e| extract(generator, e)));
            Arc::new(list(DataType::Float32, *length, Arc::new(values))?)
        }
    })
}
