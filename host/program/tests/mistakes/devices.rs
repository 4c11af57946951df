//! Devices: no emulator, wrong files, ports that are none, files that cannot be written.
//!
//! No row needs an emulator: they ask for the firmware's logic on this computer (`--on host`), or find no programs.

use crate::{Mistake, hold};
use half::f16;
use ndarray::Array3;
use ommatidia_network::network_file::NetworkFile;
use ommatidia_session::stack;
use ommatidia_shared::blob::{Bank, Header, MemoryPlan, Rcan, Sensor, Size, Tap, Weights};
use ommatidia_shared::pipeline::Pipeline;
use std::path::Path;

#[test]
fn devices_that_are_not_there_and_files_that_do_not_fit() {
    let here = "device run --with network.omm --frames frames.npy --on host";
    let mut rows = vec![
        Mistake::new("No emulator is installed", "device run --with network.omm --frames frames.npy")
            .without_other_programs()
            .exit(0)
            .says(&["not on the emulated board", "qemu-system-arm is not on the PATH", "install"]),
        Mistake::new(
            "No emulator is installed, and one was asked for",
            "device run --with network.omm --frames frames.npy --on qemu",
        )
        .without_other_programs()
        .says(&["qemu-system-arm", "install", "--on host"]),
        Mistake::new("No emulator is installed to count instructions", "device bench -o page.md")
            .without_other_programs()
            .says(&["qemu-system-arm", "install"]),
        Mistake::new("The board has another name", "device run --with network.omm --frames frames.npy --board an505")
            .exit(2)
            .says(&["an505", "mps2-an500"]),
        Mistake::new("The firmware is not there", "device status --firmware nothing.elf")
            .says(&["nothing.elf", "no such file"]),
        Mistake::new("No board is plugged in", "device status --port /dev/no-such-port")
            .says(&["/dev/no-such-port", "plugged in"]),
        Mistake::new("A port and a board of the emulator", "device status --port COM3 --board mps2-an500")
            .exit(2)
            .says(&["--port", "--board"]),
        Mistake::new(
            "The flash file is in a folder that is not there",
            "device flash --with network.omm --on host --state disk/a.flash",
        )
        .says(&["disk/a.flash", "does not exist", "create it"]),
        Mistake::new("The flash file is a folder", "device flash --with network.omm --on host --state session")
            .says(&["session", "flash memory of a board", "found a folder"]),
        Mistake::new("A checkpoint in place of a network file", "device flash --with network --on host").says(&[
            "network",
            "checkpoint",
            "ommatidia quantize",
        ]),
        Mistake::new("The network file is cut short", "device flash --with short.omm --on host")
            .with(|desk| change(desk, "short.omm", |bytes| bytes.truncate(bytes.len() / 2)))
            .says(&["short.omm", "bytes"]),
        Mistake::new("A bit of the network file is wrong", "device flash --with bit.omm --on host")
            .with(|desk| {
                // A network whose checksum is the same on every machine.
                let mut bytes = large_network().bytes().to_vec();
                let middle = bytes.len() / 2;
                bytes[middle] ^= 4;
                std::fs::write(desk.join("bit.omm"), bytes).unwrap();
            })
            .says(&["bit.omm", "damaged", "copy it again"]),
        Mistake::new("The network is larger than a slot of the flash", "device flash --with large.omm --on host")
            .with(|desk| large_network().write(&desk.join("large.omm")).unwrap())
            .says(&["refuses", "bytes", "quantize --flash"]),
        Mistake::new("Frames of another sensor", "device run --with network.omm --frames wide.npy --on host")
            .with(|desk| stack::write(&desk.join("wide.npy"), Array3::from_elem((1, 80, 96), 70.0).view()).unwrap())
            .says(&["wide.npy", "frame 0", "80 x 96"]),
        Mistake::new(
            "The table in place of the frames",
            "device run --with network.omm --frames session/bead.csv --on host",
        )
        .says(&["bead.csv", ".npy"]),
        Mistake::new("A region that lies outside the object", format!("{here} --roi 20,20,9,9"))
            .says(&["20,20,9,9", "24 x 24"]),
        Mistake::new("A region of three numbers", format!("{here} --roi 1,2,3")).exit(2).says(&["ROW,COL,ROWS,COLS"]),
        Mistake::new("The field is held without a region", format!("{here} --hold")).exit(2).says(&["--roi"]),
        Mistake::new("A camera that the device lacks", "device stream --with network.omm --live 3 --on host")
            .says(&["no working camera", "--frames"]),
        Mistake::new("A camera that is not there is set", "device camera --exposure-us 5000 --on host")
            .says(&["no working camera"]),
        Mistake::new("More light than there is", "device camera --led 120 --on host")
            .exit(2)
            .says(&["0 to 100 percent"]),
        Mistake::new("A region of the sensor of three numbers", "device camera --sensor-region 1,2,3 --on host")
            .exit(2)
            .says(&["ROW,COL,ROWS,COLS"]),
        Mistake::new(
            "Settings of a camera for frames from a file",
            "device stream --with network.omm --frames frames.npy --led 20 --on host",
        )
        .says(&["--live"]),
        Mistake::new(
            "A stream is recorded to .npy",
            "device stream --with network.omm --frames frames.npy --on host -o a.npy",
        )
        .says(&["a.npy", ".tif"]),
        Mistake::new(
            "The live view at an address of another computer",
            "device stream --with network.omm --frames frames.npy --on host --view 192.0.2.1:8080",
        )
        .says(&["192.0.2.1:8080", "live view"]),
        Mistake::new("No frame a second", "device stream --with network.omm --frames frames.npy --on host --fps 0")
            .exit(2)
            .says(&["frames a second"]),
    ];
    if cfg!(target_os = "linux") {
        rows.push(
            Mistake::new("The flash file is no file", "device flash --with network.omm --on host --state /dev/full")
                .says(&["/dev/full", "flash memory of a board", "neither a file nor a folder"]),
        );
    }
    hold("Devices", rows);
}

/// Writes a changed copy of the network file.
fn change(desk: &Path, name: &str, change: impl Fn(&mut Vec<u8>)) {
    let mut bytes = std::fs::read(desk.join("network.omm")).unwrap();
    change(&mut bytes);
    std::fs::write(desk.join(name), bytes).unwrap();
}

/// A valid network of zeros with more bytes than half of the default board's flash, 3 MiB.
fn large_network() -> NetworkFile {
    let taps = (0..12).map(|channel| Tap { channel, dy: 0, dx: 0 });
    let mut header = Header {
        name: Default::default(),
        checkpoint: Default::default(),
        frame: Size { rows: 32, cols: 32 },
        object: Size { rows: 16, cols: 16 },
        sensor: Sensor { black_level_dn: 64.0, saturation_dn: 4095, has_offset_map: false, has_gain_map: false },
        bank: Bank { tile: 512, step: 512, channels: 12, taps: taps.collect(), blocks: None },
        rcan: Rcan { width: 4, groups: 1, blocks: 1, reduction: 2 },
        memory: MemoryPlan { fast_bytes: 0, bulk_bytes: 0 },
        integers: None,
        passes: None,
        watch: None,
    };
    header.memory = Pipeline::plan(&header).unwrap();
    let lens = header.section_lens().unwrap();
    let zeros = vec![f16::ZERO; lens.filters.max(lens.rcan) as usize];
    let weights = Weights {
        filters: &zeros[..lens.filters as usize],
        index: &[],
        rcan: &zeros[..lens.rcan as usize],
        offset_dn: None,
        inverse_gain: None,
        convolutions: None,
        predictor: &[],
        watch: Default::default(),
    };
    NetworkFile::new(&header, &weights).unwrap()
}
