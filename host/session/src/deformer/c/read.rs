//! Reading what a plugin's pointers point to, with as much distrust as is possible.

use crate::deformer::limits::{LONGEST_LIST, LONGEST_TEXT};
use simod_plugin_api::{PluginError, PluginResult};
use std::ffi::c_char;

/// A struct; an error that says `what` it was if the pointer is no good.
///
/// # Safety
/// If it is not NULL and aligned, it points to a `T` that nobody writes to.
pub(super) unsafe fn one<'a, T>(pointer: *const T, what: &str) -> PluginResult<&'a T> {
    if pointer.is_null() || !pointer.is_aligned() {
        return Err(PluginError::internal(format!("{what} is NULL, or no such struct")));
    }
    // SAFETY: by the contract.
    Ok(unsafe { &*pointer })
}

/// A list; an error that says `what` it was if the pointer is no good or the count absurd.
///
/// # Safety
/// If it is not NULL and aligned, it points to `count` of `T` that nobody writes to.
pub(super) unsafe fn list<'a, T>(pointer: *const T, count: usize, what: &str) -> PluginResult<&'a [T]> {
    if count == 0 {
        return Ok(&[]);
    }
    if pointer.is_null() || !pointer.is_aligned() {
        return Err(PluginError::internal(format!("{what} are said to be {count}, and are NULL")));
    }
    if count > LONGEST_LIST {
        return Err(PluginError::internal(format!("{what} are said to be {count}")));
    }
    // SAFETY: by the contract.
    Ok(unsafe { std::slice::from_raw_parts(pointer, count) })
}

/// A text that has to be there.
///
/// # Safety
/// As for [`bytes`].
pub(super) unsafe fn text(pointer: *const c_char, what: &str) -> PluginResult<String> {
    // SAFETY: by the contract.
    let bytes = unsafe { bytes(pointer) };
    let bytes = bytes.ok_or_else(|| PluginError::internal(format!("{what} is NULL, or has no end")))?;
    std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| {
        PluginError::internal(format!("{what} is not UTF-8: `{}`", String::from_utf8_lossy(bytes)))
    })
}

/// A text that may be missing: then it is empty.
///
/// # Safety
/// As for [`bytes`].
pub(super) unsafe fn text_or_none(pointer: *const c_char, what: &str) -> PluginResult<String> {
    if pointer.is_null() {
        return Ok(String::new());
    }
    // SAFETY: by the contract.
    unsafe { text(pointer, what) }
}

/// Text of a message, as well as it can be read.
///
/// # Safety
/// As for [`bytes`].
pub(super) unsafe fn lossy(pointer: *const c_char) -> String {
    // SAFETY: by the contract.
    let bytes = unsafe { bytes(pointer) };
    bytes.map_or_else(String::new, |bytes| String::from_utf8_lossy(bytes).into_owned())
}

/// The bytes before the NUL; nothing where there is no text, or no end.
///
/// # Safety
/// If it is not NULL, it points to bytes with a NUL among them that nobody writes to.
unsafe fn bytes<'a>(pointer: *const c_char) -> Option<&'a [u8]> {
    if pointer.is_null() {
        return None;
    }
    let first = pointer.cast::<u8>();
    // SAFETY: by the contract; nothing is read beyond the NUL.
    let length = (0..LONGEST_TEXT).find(|&i| unsafe { *first.add(i) } == 0)?;
    // SAFETY: so many bytes were read just now.
    Some(unsafe { std::slice::from_raw_parts(first, length) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_looked_at() {
        // SAFETY: all of them have an end, or are NULL, or are longer than is looked at.
        unsafe {
            assert_eq!(text(c"Größe".as_ptr(), "it").as_deref(), Ok("Größe"));
            assert!(text(std::ptr::null(), "its name").unwrap_err().message.contains("its name is NULL"));
            assert!(text(c"\xff!".as_ptr(), "it").unwrap_err().message.contains("not UTF-8"));
            assert_eq!(lossy(c"\xff!".as_ptr()), "\u{fffd}!");
            assert_eq!(
                (lossy(std::ptr::null()), text_or_none(std::ptr::null(), "it").unwrap()),
                Default::default()
            );
            let endless = vec![b'x'; LONGEST_TEXT];
            assert!(text(endless.as_ptr().cast(), "it").unwrap_err().message.contains("no end"));
        }
    }

    #[test]
    fn lists_are_looked_at() {
        let numbers = [1_u32, 2];
        // SAFETY: there are two numbers; the others are refused.
        unsafe {
            assert_eq!(list(numbers.as_ptr(), 2, "they"), Ok(&numbers[..]));
            assert_eq!(list::<u32>(std::ptr::null(), 0, "they"), Ok(&[][..]));
            assert!(list::<u32>(std::ptr::null(), 2, "they").is_err());
            assert!(list(numbers.as_ptr(), usize::MAX, "they").is_err());
            assert!(list(numbers.as_ptr().wrapping_byte_add(1), 1, "they").is_err());
            assert!(one::<u32>(std::ptr::null(), "it").is_err());
        }
    }
}
