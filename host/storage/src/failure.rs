//! Failures of requests to a store, in words for people. Texts of the library are not shown where they may
//! quote a whole URL or an answer of the store, either of which may have secrets in it.

use std::error::Error as _;

use object_store::Error as StoreError;
use object_store::client::{HttpError, HttpErrorKind};
use simod_model::{Error, ErrorKind};

/// Number of times that a request is made whose answers are cut off, which the library does not repeat.
pub(crate) const TRIES: usize = 4;

/// A failure of one request, of which several may want to hear.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct RequestFailure {
    pub kind: ErrorKind,
    pub what: String,
    pub hint: String,
}

impl RequestFailure {
    /// Failure of a request, by what was wanted, as "cannot read s3://bucket/x.ply", and the error of the
    /// library.
    pub fn new(wanted: &str, error: &StoreError) -> Self {
        let (why, hint) = reason(error);
        Self { kind: ErrorKind::Io, what: format!("{wanted}: {why}"), hint: hint.to_owned() }
    }

    /// Bytes stopped too early, again and again.
    pub fn broken(wanted: &str) -> Self {
        let (what, hint) = (format!("{wanted}: {BROKEN}"), NETWORK.to_owned());
        Self { kind: ErrorKind::Io, what, hint }
    }

    /// The object has another version by now.
    pub fn changed(name: &str) -> Self {
        Self {
            kind: ErrorKind::Mismatch,
            what: format!("{name} changed while it was read"),
            hint: "wait until the program that writes it is done, then try again".to_owned(),
        }
    }
}

impl From<RequestFailure> for Error {
    fn from(failure: RequestFailure) -> Self {
        Self::new(failure.kind, failure.what, failure.hint)
    }
}

const CREDENTIALS: &str = "check the credentials in the environment, as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, and what \
                           they allow; AWS_SKIP_SIGNATURE=true reads what everybody may";

const NETWORK: &str = "check the network, and the endpoint in the environment, as AWS_ENDPOINT";

const BROKEN: &str = "the connection to the store broke, however often it was tried";

/// Whether an answer came, but was cut off.
pub(crate) fn is_cut(error: &StoreError) -> bool {
    kind(error) == Some(HttpErrorKind::Decode)
}

/// Whether an answer broke off, such as the answer that there is no such object: a request that changes
/// nothing may be made again.
pub(crate) fn broke_off(error: &StoreError) -> bool {
    is_cut(error) || kind(error) == Some(HttpErrorKind::Interrupted)
}

/// Whether a range was asked for that begins at the end of the object or behind it, as any range of an empty
/// object does.
pub(crate) fn is_beyond_end(error: &StoreError) -> bool {
    status(error).is_some_and(|(status, _)| status == "416")
}

fn reason(error: &StoreError) -> (String, &'static str) {
    match error {
        StoreError::NotFound { .. } => {
            ("there is no such bucket, object or upload".to_owned(), "check the bucket and the name")
        }
        StoreError::PermissionDenied { .. } => (answer(error, "access is denied"), CREDENTIALS),
        StoreError::Unauthenticated { .. } => (answer(error, "the store asks who you are"), CREDENTIALS),
        StoreError::NotImplemented { .. } => (
            "what is behind such a URL can only be read".to_owned(),
            "write to s3://bucket/name, or to a file",
        ),
        StoreError::NotSupported { .. } => (
            "the server gives all of it at once alone, and no ranges".to_owned(),
            "copy the model to a file, or serve it by another program",
        ),
        StoreError::InvalidPath { .. } => ("it is no name of an object".to_owned(), "check the URL"),
        _ => match connection(error) {
            Some(why) => (why.to_owned(), NETWORK),
            None if status(error).is_some() => {
                (answer(error, "the store refuses"), "try again later, or ask who runs the store")
            }
            None => (plain(error), "check the URL, and the settings in the environment: docs/storage.md"),
        },
    }
}

/// Failure of the connection in words, if the error is one.
fn connection(error: &StoreError) -> Option<&'static str> {
    Some(match kind(error)? {
        HttpErrorKind::Connect => "the store cannot be reached",
        HttpErrorKind::Timeout => "the store does not answer in time",
        _ => BROKEN,
    })
}

fn kind(error: &StoreError) -> Option<HttpErrorKind> {
    let mut next = error.source();
    while let Some(error) = next {
        if let Some(http) = error.downcast_ref::<HttpError>() {
            return Some(http.kind());
        }
        next = error.source();
    }
    None
}

/// Answer of the store: a number and, of S3, a word.
fn answer(error: &StoreError, otherwise: &str) -> String {
    match status(error) {
        Some((status, Some(code))) => format!("{otherwise}: it answers {status}, {code}"),
        Some((status, None)) => format!("{otherwise}: it answers {status}"),
        None => otherwise.to_owned(),
    }
}

/// The status of a refusal, and the store's own word for it.
fn status(error: &StoreError) -> Option<(String, Option<String>)> {
    let text = error.to_string();
    let (_, behind) = text.split_once("status code: ")?;
    let status = behind.get(..3).filter(|digits| digits.bytes().all(|b| b.is_ascii_digit()))?;
    let code = behind.split_once("<Code>").and_then(|(_, rest)| Some(rest.split_once("</Code>")?.0));
    let is_word = |code: &&str| code.len() < 64 && code.bytes().all(|b| b.is_ascii_alphanumeric());
    Some((status.to_owned(), code.filter(is_word).map(str::to_owned)))
}

/// Text of the library for an error that is no answer of a store, without the part behind a "?".
fn plain(error: &StoreError) -> String {
    let text = error.to_string();
    let cut = |word: &str| match word.split_once('?') {
        Some((url, _)) if url.contains("://") => url.to_owned(),
        _ => word.to_owned(),
    };
    text.split_whitespace().map(cut).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> RequestFailure {
        let source: Box<dyn std::error::Error + Send + Sync> = text.to_owned().into();
        RequestFailure::new("cannot read s3://b/x", &StoreError::Generic { store: "S3", source })
    }

    #[test]
    fn answers_are_told_without_what_they_quote() {
        let of_store = "Error performing GET https://h/x?X-Amz-Signature=5ecret in 1s - Server returned non-2xx status code: 503 \
                        Service Unavailable: <Error><Code>SlowDown</Code><AWSAccessKeyId>5ecret</AWSAccessKeyId></Error>";
        let failure = refused(of_store);
        assert_eq!(failure.what, "cannot read s3://b/x: the store refuses: it answers 503, SlowDown");
        let failure = refused("Unable to parse https://h/x?sig=5ecret now");
        assert!(!failure.what.contains("5ecret") && failure.what.contains("https://h/x now"), "{failure:?}");
    }
}
