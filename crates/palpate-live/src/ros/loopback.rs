//! `--localhost`: restricts sockets to the loopback interface.
//!
//! The DDS library can restrict the interfaces that it sends on, but receives on all of them.

use std::io;

/// Binds all UDP sockets of this process to the loopback interface, where the system can.
///
/// # Errors
///
/// If the system refuses.
#[cfg(target_os = "linux")]
#[allow(unsafe_code)]
pub(super) fn bind_all() -> io::Result<()> {
    use std::os::fd::{BorrowedFd, RawFd};

    use socket2::{Domain, SockRef, Type};

    let files: Vec<_> = std::fs::read_dir("/proc/self/fd")?.collect::<Result<_, _>>()?;
    let numbers = files.iter().filter_map(|file| file.file_name().to_str()?.parse::<RawFd>().ok());
    for number in numbers {
        // SAFETY: the descriptor is used only to read two socket options and to set one. These
        // calls fail if it was closed meanwhile, as that of the directory listing was. The library
        // closes none of its sockets here, so the number is not reused.
        let file = unsafe { BorrowedFd::borrow_raw(number) };
        let socket = SockRef::from(&file);
        let is_udp = socket.r#type().is_ok_and(|kind| kind == Type::DGRAM)
            && socket.domain().is_ok_and(|domain| domain == Domain::IPV4 || domain == Domain::IPV6);
        if is_udp {
            socket.bind_device(Some(b"lo"))?;
        }
    }
    Ok(())
}

#[cfg(not(target_os = "linux"))]
pub(super) fn bind_all() -> io::Result<()> {
    Ok(())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::net::UdpSocket;

    use socket2::SockRef;

    #[test]
    fn udp_sockets_are_bound_to_the_loopback_interface() {
        let socket = UdpSocket::bind("0.0.0.0:0").unwrap();
        super::bind_all().unwrap();
        assert_eq!(SockRef::from(&socket).device().unwrap().as_deref(), Some(&b"lo"[..]));
    }
}
