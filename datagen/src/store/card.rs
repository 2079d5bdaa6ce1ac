//! `README.md` of a dataset: a card whose front matter makes the folder open in Hugging Face's `datasets`.

use crate::config::Kind;
use crate::features;
use crate::info::DatasetInfo;
use crate::schema::{Column, columns};
use std::fmt::Write as _;

/// Name of the file.
pub const FILE_NAME: &str = "README.md";

/// The card's text.
pub fn text(info: &DatasetInfo) -> String {
    let columns = columns(&info.config);
    format!("{}\n{}\n{}", front_matter(info, &columns), introduction(info), table(&columns))
}

fn front_matter(info: &DatasetInfo, columns: &[Column]) -> String {
    let DatasetInfo { name, rows, .. } = info;
    let (license, size) = (&info.config.license, size_category(*rows));
    let (bytes, features) = (info.bytes(), features::yaml(columns));
    format!(
        "---
license: {license}
pretty_name: flowservo {name}
size_categories:
- {size}
task_categories:
- robotics
tags:
- visual-servoing
- synthetic
configs:
- config_name: default
  data_files:
  - split: train
    path: data/train-*
dataset_info:
  config_name: default
  features:
{features}  splits:
  - name: train
    num_bytes: {bytes}
    num_examples: {rows}
  download_size: {bytes}
  dataset_size: {bytes}
---
"
    )
}

/// Hugging Face's word for so many rows.
fn size_category(rows: u64) -> &'static str {
    match rows {
        0..1_000 => "n<1K",
        1_000..10_000 => "1K<n<10K",
        10_000..100_000 => "10K<n<100K",
        100_000..1_000_000 => "100K<n<1M",
        _ => "n>1M",
    }
}

fn introduction(info: &DatasetInfo) -> String {
    let row = match info.config.kind {
        Kind::Approach => "Two rendered images of a wrist camera, and the change of hand pose between them",
        Kind::Avoidance => {
            "A rendered image of a wrist camera, and the map of directions that obstacles block"
        }
    };
    let DatasetInfo { name, rows, version, digest, config_digest, config, .. } = info;
    format!(
        "# {name}

{row}.

{rows} rows, made by flowservo {version} with seed {seed}. Row `i` is a pure function of configuration, seed and `i`;
`dataset.json` holds the configuration and the digest of every file.

| digest | SHA-256 |
|---|---|
| data | `{digest}` |
| configuration | `{config_digest}` |

```python
import datasets
rows = datasets.load_dataset(\"path/to/this/folder\", split=\"train\")
```

Metres and radians. Frames: robot (x forward, y left, z up), hand (palm centre, z along the approach direction), camera
(x right, y down, z forward).
",
        seed = config.seed
    )
}

fn table(columns: &[Column]) -> String {
    let mut text = "| column | unit | meaning |\n|---|---|---|\n".to_owned();
    for Column { name, unit, meaning, .. } in columns {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "| `{name}` | {unit} | {meaning} |");
    }
    text
}
