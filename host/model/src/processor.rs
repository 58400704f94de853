//! The processor's time that this process takes.

/// Processor time in seconds of all threads so far, in programs and in the system, with that of the processes
/// that this one started and that have ended; none where the system does not tell.
#[cfg(target_os = "linux")]
pub fn seconds() -> Option<f64> {
    /// Ticks of what programs are told, of any Linux.
    const TICKS: f64 = 100.0;
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The second word is the program's name in brackets, which may hold anything.
    let (_, rest) = text.rsplit_once(')')?;
    let words = rest.split_whitespace().skip(11).take(4).map(|word| word.parse::<f64>().ok());
    Some(words.sum::<Option<f64>>()? / TICKS)
}

/// Returns `None`: these systems are not asked.
#[cfg(not(target_os = "linux"))]
pub fn seconds() -> Option<f64> {
    None
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn work_takes_time() {
        let before = super::seconds().unwrap();
        let start = std::time::Instant::now();
        let mut x = 1.0f64;
        while start.elapsed().as_secs_f64() < 0.3 {
            x = std::hint::black_box(x * 1.000_001);
        }
        let taken = super::seconds().unwrap() - before;
        assert!(taken > 0.05, "{taken}");
    }
}
