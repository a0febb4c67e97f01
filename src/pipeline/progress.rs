/// Told how far a run is; the terminal shows it, a library user may ignore it.
pub trait Progress: Sync {
    /// A stage begins, with `total` steps where that is known.
    fn begin(&self, stage: &str, total: Option<u64>);
    /// Another step is done.
    fn step(&self);
    /// Something that a person should know, and that is no fault.
    fn note(&self, _: &str) {}
    /// The stage is over; `reused` if an earlier run had done it.
    fn end(&self, reused: bool);
}

/// Says nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: &str, _: Option<u64>) {}
    fn step(&self) {}
    fn end(&self, _: bool) {}
}
