//! Arguments of `flowservo model alias`, `yank`, `copy` and `gc`.

use crate::cli::registry::RegistryArgs;
use clap::Args;
use registry::Location;
use std::time::Duration;

/// `model alias`
#[derive(Debug, Args)]
pub(crate) struct AliasArgs {
    /// Model name.
    pub(crate) name: String,
    /// Alias. Without it, all aliases of the model are listed.
    pub(crate) alias: Option<String>,
    /// Version to name: a number or a digest. Without it, the history of the alias is shown.
    #[arg(group = "change")]
    pub(crate) version: Option<String>,
    /// Remove the alias. Its history is kept.
    #[arg(long, requires = "alias", group = "change")]
    pub(crate) remove: bool,
    /// Change the alias only if it names this version now: a number, or `none`.
    #[arg(long, value_name = "VERSION", requires = "change")]
    pub(crate) expect: Option<String>,
    /// Reason and author.
    #[command(flatten)]
    pub(crate) note: NoteArgs,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// `model yank`
#[derive(Debug, Args)]
pub(crate) struct Yank {
    /// Version: NAME@VERSION or NAME@sha256:DIGEST.
    pub(crate) model: String,
    /// Take the yank back: the version may be used again.
    #[arg(long)]
    pub(crate) undo: bool,
    /// Reason and author.
    #[command(flatten)]
    pub(crate) note: NoteArgs,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// Reason and author of a change, recorded in the registry.
#[derive(Debug, Default, Args)]
pub(crate) struct NoteArgs {
    /// Reason, recorded in the registry.
    #[arg(long, value_name = "TEXT")]
    pub(crate) reason: Option<String>,
    /// Author, recorded in the registry.
    #[arg(long, value_name = "NAME")]
    pub(crate) by: Option<String>,
}

/// `model copy`
#[derive(Debug, Args)]
pub(crate) struct Copy {
    /// Versions: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST. With --all, model names.
    #[arg(required = true, value_name = "MODEL")]
    pub(crate) models: Vec<String>,
    /// Registry to copy to. It is created if it does not exist.
    #[arg(long, value_name = "LOCATION")]
    pub(crate) to: Location,
    /// Copy all versions of these models.
    #[arg(long)]
    pub(crate) all: bool,
    /// Also set the aliases that name the copied versions.
    #[arg(long)]
    pub(crate) aliases: bool,
    /// The registry to copy from.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// `model gc`
#[derive(Debug, Args)]
pub(crate) struct Gc {
    /// Minimum age, such as 14d or 12h. It must be longer than any publication takes.
    #[arg(long, value_name = "AGE", default_value = "14d", value_parser = age)]
    pub(crate) older_than: Duration,
    /// Delete the listed files. Without this option, nothing is changed.
    #[arg(long)]
    pub(crate) delete: bool,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// Parses a number of days, hours, minutes or seconds.
fn age(text: &str) -> Result<Duration, String> {
    let refusal = || "write a whole number of days, hours, minutes or seconds: 14d, 12h, 30m, 10s".to_owned();
    let unit = text.chars().last().ok_or_else(refusal)?;
    let seconds = match unit {
        'd' => 24 * 3600,
        'h' => 3600,
        'm' => 60,
        's' => 1,
        _ => return Err(refusal()),
    };
    let number: u32 = text[..text.len() - 1].parse().map_err(|_| refusal())?;
    Ok(Duration::from_secs(u64::from(number) * seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages() {
        assert_eq!(age("14d"), Ok(registry::GRACE));
        assert_eq!(age("90m"), Ok(Duration::from_mins(90)));
        assert_eq!(age("0s"), Ok(Duration::ZERO));
        for bad in ["", "14", "d", "-1d", "1.5h", "1w", "2 d", "1é"] {
            assert!(age(bad).is_err(), "{bad}");
        }
    }
}
