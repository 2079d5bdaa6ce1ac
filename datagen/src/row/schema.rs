//! The Arrow schema of a dataset.
//!
//! The types are those that Hugging Face `datasets`, `DuckDB`, polars and pyarrow open directly. Every field is nullable although
//! no value is null, images are structs of `bytes` and `path` in this order, and the metadata describes the features.

use super::column::{Column, Content, columns};
use super::features;
use crate::config::DatasetConfig;
use arrow_schema::{DataType, Field, Fields, Schema};
use std::collections::HashMap;
use std::sync::Arc;

/// Returns the Arrow schema of a dataset.
pub fn schema(config: &DatasetConfig) -> Schema {
    let columns = columns(config);
    let fields: Fields = columns.iter().map(field).collect();
    let metadata = HashMap::from([(features::KEY.to_owned(), features::json(&columns))]);
    Schema::new_with_metadata(fields, metadata)
}

fn field(column: &Column) -> Field {
    let data_type = match &column.content {
        Content::Image(..) => DataType::Struct(image_fields()),
        Content::Count(_) => DataType::UInt64,
        Content::Class(..) => DataType::Int64,
        Content::Text(_) => DataType::Utf8,
        Content::Doubles(length, _) => {
            DataType::FixedSizeList(list_item(DataType::Float64), i32::from(*length))
        }
        Content::Floats(length, _) => {
            DataType::FixedSizeList(list_item(DataType::Float32), i32::from(*length))
        }
    };
    let field = Field::new(column.name, data_type, true);
    if column.unit.is_empty() {
        return field;
    }
    field.with_metadata(HashMap::from([("unit".to_owned(), column.unit.to_owned())]))
}

/// Returns the field of the items of a list.
pub(super) fn list_item(item: DataType) -> Arc<Field> {
    Arc::new(Field::new("item", item, true))
}

/// Returns the fields of an image.
pub(super) fn image_fields() -> Fields {
    vec![Field::new("bytes", DataType::Binary, true), Field::new("path", DataType::Utf8, true)].into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;
    use std::fmt::Write as _;

    fn described(schema: &Schema) -> String {
        schema.fields().iter().fold(String::new(), |mut text, field| {
            let unit = field.metadata().get("unit").map(|unit| format!(" [{unit}]")).unwrap_or_default();
            writeln!(text, "{}: {}{unit}", field.name(), field.data_type()).unwrap();
            text
        })
    }

    #[test]
    fn the_schemas_are_as_published() {
        assert_eq!(
            described(&schema(&fixture::config("a", 1))),
            include_str!("../../testdata/approach.schema")
        );
        assert_eq!(
            described(&schema(&fixture::config("avoid", 1))),
            include_str!("../../testdata/avoidance.schema")
        );
    }

    /// With a single field that is not nullable, `datasets` silently loses the images.
    #[test]
    fn every_field_and_every_child_is_nullable() {
        fn nullable(field: &Field) -> bool {
            field.is_nullable()
                && match field.data_type() {
                    DataType::Struct(fields) => fields.iter().all(|field| nullable(field)),
                    DataType::FixedSizeList(item, _) => nullable(item),
                    _ => true,
                }
        }
        for name in ["a", "avoid"] {
            assert!(schema(&fixture::config(name, 1)).fields().iter().all(|field| nullable(field)));
        }
    }
}
