//! What each operator costs on the microcontroller is what `docs/instructions.md` says.
#![allow(clippy::unwrap_used)]

use ommatidia_host::device::{DeviceError, Firmware, OperatorCount, count_operators, find_qemu, table};
use std::path::Path;

/// The counts of this tree, or what is missing to take them.
fn counts() -> Result<Vec<OperatorCount>, String> {
    let firmware = match Firmware::build("bench") {
        Ok(_) if find_qemu().is_none() => return Err("qemu-system-arm is not on the PATH".into()),
        Ok(firmware) => firmware,
        Err(DeviceError::NoFirmware { detail }) => return Err(detail),
        Err(error) => panic!("{error}"),
    };
    match count_operators(&firmware) {
        Ok(counts) => Ok(counts),
        // No C compiler, or a QEMU whose plugins are of another version.
        Err(error @ DeviceError::Counter { .. }) => Err(error.to_string()),
        Err(error) => panic!("{error}"),
    }
}

/// Where something is missing the test counts as skipped; under `cargo verify`, which installs it, it fails. With `OMMATIDIA_RENEW` it
/// writes the page.
#[test]
fn no_operator_takes_more_instructions_than_the_page_says() {
    let counts = match counts() {
        Ok(counts) => counts,
        Err(missing) => {
            assert!(std::env::var_os("OMMATIDIA_REQUIRE_QEMU").is_none(), "{missing}");
            return ommatidia_tests::skip("no_operator_takes_more_instructions_than_the_page_says", &missing);
        }
    };
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/instructions.md");
    if std::env::var_os("OMMATIDIA_RENEW").is_some() {
        std::fs::write(&page, table::page(&counts)).unwrap();
    }
    let complaints = table::complaints(&std::fs::read_to_string(&page).unwrap_or_default(), &counts);
    assert!(complaints.is_empty(), "docs/instructions.md against this tree:\n{}", complaints.join("\n"));
}
