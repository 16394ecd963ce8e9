//! The peak memory of this process.

/// The peak of the resident set so far, bytes; `None` if the system does not report it.
///
/// Linux does, in `/proc/self/status`; the count begins with the program, not with its parent.
pub(super) fn resident_bytes() -> Option<u64> {
    resident_in(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// The peak in the text of `/proc/self/status`, bytes.
fn resident_in(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_in_bytes_or_not_at_all() {
        let status = "Name:\tpalpate\nVmPeak:\t  900 kB\nVmHWM:\t   12 kB\nVmRSS:\t 8 kB\n";
        assert_eq!(resident_in(status), Some(12 << 10));
        assert_eq!(resident_in("VmRSS:\t 8 kB\n"), None);
        assert_eq!(resident_in("VmHWM:\t many\n"), None);
    }
}
