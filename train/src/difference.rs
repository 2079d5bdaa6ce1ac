//! The first difference between two configurations.

use toml::Value;

/// Returns the first key in which two TOML values differ, dotted, with both values.
pub(crate) fn difference(first: &Value, second: &Value) -> Option<[String; 3]> {
    below("", first, second)
}

fn below(key: &str, first: &Value, second: &Value) -> Option<[String; 3]> {
    if let (Value::Array(a), Value::Array(b)) = (first, second)
        && a.len() == b.len()
    {
        let mut items = a.iter().zip(b).enumerate();
        return items.find_map(|(index, (a, b))| below(&format!("{key}.{index}"), a, b));
    }
    let (Value::Table(a), Value::Table(b)) = (first, second) else {
        return (first != second).then(|| [key.to_owned(), first.to_string(), second.to_string()]);
    };
    let absent = Value::String("absent".to_owned());
    a.keys().chain(b.keys()).find_map(|name| {
        let inner = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
        below(&inner, a.get(name).unwrap_or(&absent), b.get(name).unwrap_or(&absent))
    })
}
