//! Results of operations that do nothing if their work is done already.

/// What an idempotent operation did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome<T> {
    /// It created this.
    New(T),
    /// This existed before. Nothing was changed.
    AlreadyThere(T),
}

impl<T> Outcome<T> {
    /// Returns what exists now.
    pub fn value(&self) -> &T {
        match self {
            Self::New(value) | Self::AlreadyThere(value) => value,
        }
    }

    /// Returns whether the operation created something.
    pub fn is_new(&self) -> bool {
        matches!(self, Self::New(_))
    }
}
