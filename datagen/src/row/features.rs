//! The columns as Hugging Face `datasets` features: JSON in the Parquet files, YAML on the card.

use super::column::{Column, Content};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;

/// Key of the features in the metadata of the Arrow schema and of the Parquet footer.
pub const KEY: &str = "huggingface";

/// Returns `{"info": {"features": {...}}}`, in the form that `datasets` writes.
pub fn json(columns: &[Column]) -> String {
    let features: Map<String, Value> =
        columns.iter().map(|column| (column.name.to_owned(), feature(&column.content))).collect();
    json!({ "info": { "features": features } }).to_string()
}

fn feature(content: &Content) -> Value {
    let value = |dtype: &str| json!({ "dtype": dtype, "_type": "Value" });
    let list =
        |dtype: &str, length: u16| json!({ "feature": value(dtype), "length": length, "_type": "List" });
    match content {
        Content::Image(..) => json!({ "_type": "Image" }),
        Content::Count(_) => value("uint64"),
        Content::Class(names, _) => json!({ "names": names, "_type": "ClassLabel" }),
        Content::Text(_) => value("string"),
        Content::Doubles(length, _) => list("float64", *length),
        Content::Floats(length, _) => list("float32", *length),
    }
}

/// Returns the items of `dataset_info.features` on a card.
pub fn yaml(columns: &[Column]) -> String {
    let mut text = String::new();
    for Column { name, content, .. } in columns {
        let kind = match content {
            Content::Image(..) => "    dtype: image\n".to_owned(),
            Content::Count(_) => "    dtype: uint64\n".to_owned(),
            Content::Class(names, _) => classes(names),
            Content::Text(_) => "    dtype: string\n".to_owned(),
            Content::Doubles(length, _) => format!("    list: float64\n    length: {length}\n"),
            Content::Floats(length, _) => format!("    list: float32\n    length: {length}\n"),
        };
        // Writing to a string cannot fail.
        let _ = write!(text, "  - name: {name}\n{kind}");
    }
    text
}

fn classes(names: &[String]) -> String {
    let mut text = "    dtype:\n      class_label:\n        names:\n".to_owned();
    for (i, name) in names.iter().enumerate() {
        let _ = writeln!(text, "          '{i}': {}", Value::from(name.as_str()));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;
    use crate::row::column::columns;

    /// The expected text is what `datasets` 5.2.0 writes for these types.
    #[test]
    fn features_are_those_that_datasets_writes() {
        let text = json(&columns(&fixture::config("avoid", 1)));
        let features: Value = serde_json::from_str(&text).unwrap();
        let features = &features["info"]["features"];
        assert_eq!(features["image"].to_string(), r#"{"_type":"Image"}"#);
        assert_eq!(
            features["values"],
            json!({"feature": {"dtype": "float32", "_type": "Value"}, "length": 180, "_type": "List"})
        );
        assert_eq!(features["motion"], json!({"names": ["range 1", "range 2a"], "_type": "ClassLabel"}));
        assert_eq!(features["seed"], json!({"dtype": "uint64", "_type": "Value"}));
    }
}
