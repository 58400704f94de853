//! Errors as values: the fault and its place, and advice.

use std::fmt;
use std::path::Path;
use std::sync::Arc;

/// Result of every fallible function of the host's crates.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Kind of a failure, for callers that treat some kinds specially.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The operating system refused to read or write.
    Io,
    /// The content of a file is not what the file's format, or its own header, says.
    Format,
    /// The content is well-formed, but there is nothing that can be worked on (no vertices, say).
    Degenerate,
    /// Files that belong together do not fit (another vertex count, a source changed since sampling).
    Mismatch,
    /// A value given by the user is out of the range allowed, unknown or of another type.
    Argument,
    /// A plugin is missing, cannot be loaded, or failed.
    Plugin,
    /// The user asked to stop.
    Cancelled,
    /// A mistake in this program: its input is not to blame.
    Internal,
}

/// Property of some failures within their kind, for callers that treat these specially.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorMark {
    /// The source of a sampled model is gone, or is not what was sampled: another path may help.
    OtherSource,
    /// A plugin has a mistake for certain: it panicked, or gave an answer that breaks a rule of the
    /// interface. Other errors of plugins are refusals of what they were given, or may have other causes too,
    /// as positions that are not finite have.
    PluginBug,
}

/// Failure: one line with the fault and its place, one with advice.
///
/// An error is one pointer, as results that may be one are moved, and let go, wherever they are passed on.
/// What makes one is cold, so that the compiler spends little on the code around it.
#[derive(Debug, Clone)]
pub struct Error(Box<Failure>);

#[derive(Debug, Clone)]
struct Failure {
    kind: ErrorKind,
    what: String,
    hint: String,
    mark: Option<ErrorMark>,
    /// Error of a library or the system that caused this one, if there is one.
    source: Option<Arc<dyn std::error::Error + Send + Sync>>,
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.what)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.0.source.as_deref().map(|source| source as _)
    }
}

impl Error {
    /// Failure of the given kind; `what` names the fault and its place, `hint` the advice.
    #[cold]
    pub fn new(kind: ErrorKind, what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self(Box::new(Failure { kind, what: what.into(), hint: hint.into(), mark: None, source: None }))
    }

    /// A value of the user's that is out of range, unknown or of another type.
    #[cold]
    pub fn argument(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(ErrorKind::Argument, what, hint)
    }

    /// Error of content that is not what its format, or its own header, says.
    #[cold]
    pub fn format(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(ErrorKind::Format, what, hint)
    }

    /// Files that belong together and do not fit.
    #[cold]
    pub fn mismatch(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(ErrorKind::Mismatch, what, hint)
    }

    /// Content that is well-formed, and with which nothing can be done.
    #[cold]
    pub fn degenerate(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(ErrorKind::Degenerate, what, hint)
    }

    /// A plugin that is missing, cannot be loaded, or failed.
    #[cold]
    pub fn plugin(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(ErrorKind::Plugin, what, hint)
    }

    /// Error of an operation that the operating system refused, other than [reading or writing a
    /// file](Self::io).
    #[cold]
    pub fn system(what: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(ErrorKind::Io, what, hint)
    }

    /// A mistake in this program, which users are asked to report.
    #[cold]
    pub fn internal(what: impl Into<String>) -> Self {
        Self::new(ErrorKind::Internal, what, "this is a mistake in the program: please report it")
    }

    /// Error of content that this program made and that the format cannot hold, which is a mistake in the
    /// program.
    #[cold]
    pub fn unwritable(
        what: impl fmt::Display,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        let source = source.into();
        Self::internal(format!("cannot write {what}: {source}")).because(source)
    }

    /// Error of a file that another process changed while it was read.
    #[cold]
    pub fn changed_while_read(path: &Path) -> Self {
        let hint = "wait until the program that writes it is done, then try again";
        Self::mismatch(format!("{} changed while it was read", path.display()), hint)
    }

    /// Returns this error with the one that caused it.
    #[cold]
    pub fn because(mut self, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        self.0.source = Some(source.into().into());
        self
    }

    /// Returns this error with a mark, which stays when texts and source change.
    #[cold]
    pub fn marked(mut self, mark: ErrorMark) -> Self {
        self.0.mark = Some(mark);
        self
    }

    /// Returns this error with another text of what failed.
    #[cold]
    pub fn saying(mut self, what: impl Into<String>) -> Self {
        self.0.what = what.into();
        self
    }

    /// Returns this error with other advice.
    #[cold]
    pub fn hinting(mut self, hint: impl Into<String>) -> Self {
        self.0.hint = hint.into();
        self
    }

    /// Error of writing a file: the error of our own writer, which knows best, where `error` holds one, or
    /// else that of the system.
    #[cold]
    pub fn written(path: &Path, error: std::io::Error) -> Self {
        error.downcast::<Self>().unwrap_or_else(|error| Self::io("write", path, &error))
    }

    /// A refused file operation: `action` completes "cannot …", as in "cannot read x.ply: permission denied".
    #[cold]
    pub fn io(action: &str, path: &Path, source: &std::io::Error) -> Self {
        use std::io::ErrorKind as K;
        let hint = match source.kind() {
            K::NotFound => "check the path; it is relative to the current folder",
            K::PermissionDenied => "check the permissions of the file and of its folder",
            K::StorageFull | K::QuotaExceeded => "free some space, or write to another disk",
            K::FileTooLarge => "raise the limit on the size of files, or write to another disk",
            K::IsADirectory => "give the path of a file, not of a folder",
            K::NotADirectory => "a part of the path is a file where a folder is needed",
            K::ReadOnlyFilesystem => "write to another disk",
            _ => "check the disk and the path, then try again",
        };
        // "No such file or directory (os error 2)" without the number, which helps no user.
        let text = source.to_string();
        let text = text.split(" (os error").next().unwrap_or(&text).to_lowercase();
        // The system's errors cannot be copied, but their numbers say all.
        let same = source.raw_os_error().map(std::io::Error::from_raw_os_error);
        let same = same.unwrap_or_else(|| std::io::Error::new(source.kind(), source.to_string()));
        Self::new(ErrorKind::Io, format!("cannot {action} {}: {text}", path.display()), hint).because(same)
    }

    /// The user asked to stop.
    #[cold]
    pub fn cancelled() -> Self {
        Self::new(ErrorKind::Cancelled, "cancelled", "nothing is left half done; start again when you like")
    }

    /// Kind of the failure.
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// Whether the error has this mark.
    pub fn is_marked(&self, mark: ErrorMark) -> bool {
        self.0.mark == Some(mark)
    }

    /// Advice of what to do about the failure: one line, no full stop.
    pub fn hint(&self) -> &str {
        &self.0.hint
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error as _;
    use std::io;

    #[test]
    fn marks_stay_when_texts_and_source_change() {
        let error = Error::mismatch("x.ply changed", "sample it again").marked(ErrorMark::OtherSource);
        let error = error.saying("other words").hinting("other advice").because(io::Error::other("a cause"));
        assert!(error.is_marked(ErrorMark::OtherSource) && !error.is_marked(ErrorMark::PluginBug));
        assert!(!Error::cancelled().is_marked(ErrorMark::OtherSource));
    }

    #[test]
    fn what_it_came_of_is_kept() {
        let source = io::Error::from(io::ErrorKind::PermissionDenied);
        let error =
            Error::io("read", Path::new("x.ply"), &source).saying("other words").hinting("other advice");
        assert_eq!((error.kind(), error.to_string().as_str()), (ErrorKind::Io, "other words"));
        assert_eq!(error.hint(), "other advice");
        let kept = error.source().and_then(|e| e.downcast_ref::<io::Error>()).expect("a source");
        assert_eq!(kept.kind(), io::ErrorKind::PermissionDenied);
        let missing = std::fs::File::open("/no/such/file").expect_err("no file");
        let number = missing.raw_os_error();
        let error = Error::io("read", Path::new("/no/such/file"), &missing);
        let kept = error.source().and_then(|e| e.downcast_ref::<io::Error>()).expect("a source");
        assert_eq!(kept.raw_os_error(), number);
        assert!(Error::cancelled().source().is_none());
        let error = Error::unwritable("the plan", missing);
        assert_eq!(error.kind(), ErrorKind::Internal);
        assert!(error.to_string().starts_with("cannot write the plan: "), "{error}");
        assert!(error.clone().source().is_some_and(|source| source.is::<io::Error>()));
    }
}
