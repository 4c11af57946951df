//! The state machine.

use super::io::{FrameSink, FrameSource, Monitor};
use super::refuse::{refusal, saturated, storage};
use super::shutter::Shutter;
use super::upload::Upload;
use crate::blob::{CRC, MemoryPlan, Network, Verified};
use crate::flash::{MappedFlash, Slots};
use crate::image::Region;
use crate::pipeline::{HeldRegion, Holder, Memory, Pipeline};
use crate::watch::Watch;
use crate::wire::{
    CHUNK, CameraChange, CameraStatus, FrameError, FrameFrom, Info, Refusal, Reply, Request, RunReport, SCHEMA_KEY,
    SlotReport, Telemetry, Transfer, Unpacker, VERSION,
};
use half::f16;
use heapless::String;

/// Working memory of the pipeline, kept from run to run.
#[derive(Debug)]
pub struct Arenas<'m> {
    /// Fast scratch.
    pub fast: &'m mut [f32],
    /// Bulk arena.
    pub bulk: &'m mut [f16],
}

impl Arenas<'_> {
    /// Their sizes, bytes.
    fn sizes(&self) -> MemoryPlan {
        let bytes = |len: usize| u32::try_from(len).unwrap_or(u32::MAX);
        MemoryPlan { fast_bytes: bytes(size_of_val(self.fast)), bulk_bytes: bytes(size_of_val(self.bulk)) }
    }
}

/// The device: its flash, its frames, its working memory, and the state of the conversation with the host.
#[derive(Debug)]
pub struct Device<'m, F, S, K, M> {
    board: &'static str,
    slots: Slots<F>,
    /// Proof that the file in the active slot was checked.
    verified: Option<Verified>,
    source: S,
    sink: K,
    arenas: Arenas<'m>,
    monitor: M,
    blob: Upload,
    /// Whether the last transfer of a network file was committed.
    committed: bool,
    frame: Upload,
    /// Whether the host has begun a frame that was not reconstructed yet.
    frame_waits: bool,
    shutter: Shutter,
    last_run: Option<RunReport>,
    /// The `hold` of that run's request.
    last_hold: u16,
    /// Statistics of the field.
    field: Holder,
    /// Number of the run that measured them.
    field_id: u32,
    /// The watch on the optics since the network was sent.
    watch: Watch,
    telemetry: Telemetry,
}

impl<'m, F: MappedFlash, S: FrameSource, K: FrameSink, M: Monitor> Device<'m, F, S, K, M> {
    /// A device that runs the newest network in its flash that passes every check, if there is one.
    pub fn new(board: &'static str, flash: F, source: S, sink: K, arenas: Arenas<'m>, monitor: M) -> Self {
        let mut device = Self {
            board,
            slots: Slots::new(flash),
            verified: None,
            source,
            sink,
            arenas,
            monitor,
            blob: Upload::none(Transfer::Blob),
            committed: false,
            frame: Upload::none(Transfer::Frame),
            frame_waits: false,
            shutter: Shutter::default(),
            last_run: None,
            last_hold: 0,
            field: Holder::default(),
            field_id: 0,
            watch: Watch::new(),
            telemetry: Telemetry::default(),
        };
        device.start();
        device
    }

    /// Activates the newest committed file that passes every check. After starts that ended in faults, none.
    fn start(&mut self) {
        self.telemetry.started_by = self.monitor.start_cause();
        self.telemetry.starts = self.monitor.starts();
        self.telemetry.core_mhz = self.monitor.core_mhz();
        if self.monitor.keeps_faulting() {
            self.telemetry.refused_slots = self.slots.committed().iter().flatten().count() as u8;
            return;
        }
        for (slot, mark) in self.slots.committed().into_iter().flatten() {
            self.monitor.alive();
            if let Some(verified) = self.slots.file(slot, &mark).and_then(|file| self.check(file).ok()) {
                self.slots.activate(slot, mark);
                self.verified = Some(verified);
                return;
            }
            self.telemetry.refused_slots += 1;
        }
    }

    /// Handles a request and returns the reply. A repeated request gets the same reply.
    pub fn handle(&mut self, request: Request<'_>) -> Reply<'_> {
        let done = match request {
            Request::Hello { version, schema } => self.hello(version, schema).map(Reply::Hello),
            Request::Begin { what: Transfer::Blob, len } => self.begin_blob(len).map(|()| Reply::Done),
            Request::Begin { what: Transfer::Frame, len } => self.begin_frame(len).map(|()| Reply::Done),
            Request::Chunk { what, offset, data } => {
                self.chunk(what, offset, data).map(|offset| Reply::Received { offset })
            }
            Request::Packed { offset, pixels, data } => {
                self.packed(offset, pixels, data).map(|offset| Reply::Received { offset })
            }
            Request::Commit => self.commit().map(|()| Reply::Done),
            Request::Run { id, frame, region, hold } => self.run(id, frame, region, hold).map(Reply::Ran),
            Request::Read { id, offset, len } => return self.read(id, offset, len).unwrap_or_else(Reply::Refused),
            Request::Camera(change) => self.camera(change).map(Reply::Camera),
            Request::Telemetry => Ok(Reply::Telemetry(self.telemetry())),
            Request::Quit => Ok(Reply::Done),
        };
        let reply = done.unwrap_or_else(Reply::Refused);
        self.monitor.answers(&request, &reply);
        reply
    }

    /// Reports to the board that the program is alive.
    pub fn alive(&mut self) {
        self.monitor.alive();
    }

    /// Counts a packet that was dropped, and why if it was damaged.
    pub fn count_dropped(&mut self, why: Option<FrameError>) {
        self.telemetry.dropped_packets = self.telemetry.dropped_packets.wrapping_add(1);
        if matches!(why, Some(FrameError::Crc { .. })) {
            self.telemetry.crc_errors = self.telemetry.crc_errors.wrapping_add(1);
        }
    }

    /// Counts a request that was answered before.
    pub fn count_repeated(&mut self) {
        self.telemetry.repeated_requests = self.telemetry.repeated_requests.wrapping_add(1);
    }

    /// Begins a conversation, perhaps hours after the last one: statistics of the field from then belong to another
    /// scene.
    fn hello(&mut self, version: u16, schema: u64) -> Result<Info, Refusal> {
        self.field.forget();
        if version != VERSION {
            return Err(Refusal::Version { expected: VERSION, found: version });
        }
        if schema != SCHEMA_KEY {
            return Err(Refusal::Schema { expected: SCHEMA_KEY, found: schema });
        }
        let sizes = self.arenas.sizes();
        let mut board = String::new();
        for c in self.board.chars() {
            let _cut = board.push(c);
        }
        Ok(Info {
            version: VERSION,
            schema: SCHEMA_KEY,
            board,
            blob_bytes: saturated(self.slots.capacity()),
            frame_px: saturated(self.source.capacity()),
            object_px: saturated(self.sink.capacity()),
            fast_bytes: sizes.fast_bytes,
            bulk_bytes: sizes.bulk_bytes,
            live: self.source.camera().is_some(),
        })
    }

    /// Begins the transfer of a network file. The active network runs on until the new one is committed.
    fn begin_blob(&mut self, len: u32) -> Result<(), Refusal> {
        self.committed = false;
        self.blob.begin(0);
        self.slots.begin(len as usize).map_err(|e| storage(e, Transfer::Blob))?;
        self.blob.begin(len);
        Ok(())
    }

    fn begin_frame(&mut self, len: u32) -> Result<(), Refusal> {
        // The same length again before any byte is a request whose answer the line has lost.
        if core::mem::replace(&mut self.frame_waits, true) && !self.frame.has_just_begun(len) {
            self.telemetry.dropped_frames = self.telemetry.dropped_frames.wrapping_add(1);
        }
        self.last_run = None;
        self.frame.begin(0);
        // An odd length has half a pixel at its end, which is not stored; the run then refuses the length.
        self.source.begin((len / 2) as usize).map_err(|e| storage(e, Transfer::Frame))?;
        self.frame.begin(len);
        Ok(())
    }

    fn chunk(&mut self, what: Transfer, offset: u32, data: &[u8]) -> Result<u32, Refusal> {
        let upload = match what {
            Transfer::Blob => &mut self.blob,
            Transfer::Frame => &mut self.frame,
        };
        let known = upload.accept(offset, data.len())?;
        let (at, new) = (offset as usize + known, data.get(known..).unwrap_or_default());
        if !new.is_empty() {
            let stored = match what {
                Transfer::Blob => self.slots.write(at, new),
                Transfer::Frame => self.source.write(at, new),
            };
            stored.map_err(|e| storage(e, what))?;
            upload.advance(new.len());
        }
        Ok(upload.received())
    }

    /// Stores packed pixels. Those that have arrived before are written again, which changes nothing.
    fn packed(&mut self, offset: u32, pixels: u16, data: &[u8]) -> Result<u32, Refusal> {
        let len = 2 * usize::from(pixels);
        let known = self.frame.accept(offset, len)?;
        let mut unpacker = Unpacker::new(data).take(pixels.into());
        let (mut buffer, mut found) = ([[0; 2]; 64], 0);
        while found < pixels {
            let mut count = 0;
            for (to, code) in buffer.iter_mut().zip(&mut unpacker) {
                *to = code.to_le_bytes();
                count += 1;
            }
            if count == 0 {
                return Err(Refusal::Packed { expected: pixels, found });
            }
            let at = offset as usize + 2 * usize::from(found);
            let bytes = buffer.as_flattened().get(..2 * usize::from(count)).unwrap_or_default();
            self.source.write(at, bytes).map_err(|e| storage(e, Transfer::Frame))?;
            found += count;
        }
        self.frame.advance(len - known);
        Ok(self.frame.received())
    }

    /// Checks every bit of the network file where it lies in the flash, and marks it as the active one.
    fn commit(&mut self) -> Result<(), Refusal> {
        if self.committed {
            return Ok(());
        }
        self.blob.complete()?;
        // This writes the last bytes. The file is borrowed again afterwards.
        self.slots.finish().map_err(|e| storage(e, Transfer::Blob))?;
        let verified = self.check(self.slots.staged_file().ok_or(Refusal::Storage)?)?;
        self.slots.commit().map_err(|e| storage(e, Transfer::Blob))?;
        self.verified = Some(verified);
        self.committed = true;
        self.last_run = None;
        self.field.forget();
        self.watch.restart();
        self.telemetry.watch = Default::default();
        Ok(())
    }

    /// Checks every bit of a network file, and that the network can run here.
    fn check(&self, file: &[u8]) -> Result<Verified, Refusal> {
        let verified = Verified::check(file).map_err(Refusal::Blob)?;
        let network = verified.open(file).map_err(Refusal::Blob)?;
        network.header().memory.fits(self.arenas.sizes()).map_err(Refusal::Blob)?;
        let pipeline = Pipeline::new(&network).map_err(refusal)?;
        let (frame_px, object_px) = (self.source.capacity(), self.sink.capacity());
        if pipeline.frame_len() > frame_px {
            let needed = saturated(2 * pipeline.frame_len());
            return Err(Refusal::NoRoom { what: Transfer::Frame, needed, available: saturated(2 * frame_px) });
        }
        if pipeline.output_len() > object_px {
            let needed = saturated(pipeline.output_len());
            return Err(Refusal::ObjectRoom { needed, available: saturated(object_px) });
        }
        Ok(verified)
    }

    fn camera(&mut self, change: CameraChange) -> Result<CameraStatus, Refusal> {
        let frame_px = self.source.capacity();
        let camera = self.source.camera().ok_or(Refusal::NoCamera)?;
        self.shutter.change(camera, change, frame_px)
    }

    fn run(&mut self, id: u32, from: FrameFrom, region: Option<Region>, hold: u16) -> Result<RunReport, Refusal> {
        let network = active_network(&self.slots, self.verified)?;
        let pipeline = Pipeline::new(&network).map_err(refusal)?;
        let region = region.unwrap_or(pipeline.whole());
        let same = |report: &RunReport| {
            let last_from = if report.capture.is_some() { FrameFrom::Camera } else { FrameFrom::Host };
            (report.id, last_from, report.region, self.last_hold) == (id, from, region, hold)
        };
        if let Some(report) = self.last_run.filter(same) {
            return Ok(report);
        }
        pipeline.check_region(region).map_err(refusal)?;
        let expected = saturated(2 * pipeline.frame_len());
        let found = match from {
            FrameFrom::Host => self.frame.complete()?,
            FrameFrom::Camera => {
                let camera = self.source.camera().ok_or(Refusal::NoCamera)?;
                saturated(camera.settings().region.pixels().saturating_mul(2))
            }
        };
        if expected != found {
            return Err(Refusal::FrameLength { expected, found });
        }
        let capture = match from {
            FrameFrom::Host => None,
            FrameFrom::Camera => {
                // It lies where the host's frame lay.
                self.frame.begin(0);
                let dropped = u32::from(core::mem::take(&mut self.frame_waits));
                self.telemetry.dropped_frames = self.telemetry.dropped_frames.wrapping_add(dropped);
                let (camera, monitor) = (self.source.camera().ok_or(Refusal::NoCamera)?, &mut self.monitor);
                Some(self.shutter.take(camera, &mut || monitor.alive())?)
            }
        };
        let frame = self.source.frame().map_err(|e| storage(e, Transfer::Frame))?;
        let frame_crc = CRC.checksum(bytemuck::cast_slice(frame));
        let object = self.sink.begin(region.pixels()).map_err(|_| Refusal::Storage)?;
        // More scratch would not help. The rest of the fast memory is not touched.
        let fast_len = self.arenas.fast.len().min(pipeline.fast_len_best() + pipeline.scales_len());
        let fast = self.arenas.fast.get_mut(..fast_len).unwrap_or_default();
        self.monitor.run_begins();
        let memory = Memory { fast, bulk: self.arenas.bulk };
        let run = self.field.run(&pipeline, frame, HeldRegion { region, hold }, memory, object);
        if let (Ok((stats, _)), Some(maps)) = (&run, network.watch()) {
            self.watch.see(&maps, frame, stats.saturated_px, id);
            self.telemetry.watch = self.watch.report(&maps);
        }
        let cycles = self.monitor.run_ends();
        let (stats, field_age) = run.map_err(refusal)?;
        if field_age == 0 {
            self.field_id = id;
        }
        let object_crc = CRC.checksum(bytemuck::cast_slice(object));
        self.telemetry.cycles = cycles;
        self.telemetry.saturated_px = self.telemetry.saturated_px.wrapping_add(stats.saturated_px.into());
        self.telemetry.fast_bytes = saturated(fast_len * size_of::<f32>());
        self.telemetry.bulk_bytes = network.header().memory.bulk_bytes;
        self.telemetry.frame_bytes = expected;
        self.telemetry.object_bytes = saturated(2 * region.pixels());
        self.telemetry.runs = self.telemetry.runs.wrapping_add(1);
        self.telemetry.held_runs = self.telemetry.held_runs.wrapping_add((field_age > 0).into());
        self.sink.finish().map_err(|_| Refusal::Storage)?;
        let report = RunReport {
            id,
            region,
            field_id: self.field_id,
            field_age,
            len: saturated(2 * region.pixels()),
            saturated_px: stats.saturated_px,
            frame_max_dn: stats.frame_max_dn,
            filter_finite: stats.filter_finite,
            frame_crc,
            object_crc,
            capture,
            watch: self.telemetry.watch,
        };
        self.frame_waits = false;
        (self.last_run, self.last_hold) = (Some(report), hold);
        Ok(report)
    }

    fn read(&self, id: u32, offset: u32, len: u16) -> Result<Reply<'_>, Refusal> {
        let last = self.last_run.map(|report| report.id);
        if last != Some(id) {
            return Err(Refusal::NoResult { expected: last, found: id });
        }
        // Halves are little-endian in memory as on the line: every target is little-endian.
        let bytes: &[u8] = bytemuck::cast_slice(self.sink.object());
        let end = u64::from(offset) + u64::from(len);
        let past = Refusal::PastEnd { len: saturated(bytes.len()), found: end };
        if usize::from(len) > CHUNK || end > bytes.len() as u64 {
            return Err(past);
        }
        let data = bytes.get(offset as usize..end as usize).ok_or(past)?;
        Ok(Reply::Data { offset, data })
    }

    fn telemetry(&mut self) -> Telemetry {
        let footprint = self.monitor.footprint();
        let active = self.slots.active();
        let report = |(slot, mark)| SlotReport { slot, mark, runs: active == Some((slot, mark)) };
        Telemetry {
            slots: self.slots.committed().map(|slot| slot.map(report)),
            network: self.network_name(),
            temperature_cdeg: self.monitor.temperature_cdeg(),
            activity: self.monitor.activity(),
            image_bytes: footprint.image_bytes,
            static_bytes: footprint.static_bytes,
            stack_bytes: footprint.stack_bytes,
            ..self.telemetry.clone()
        }
    }

    fn network_name(&self) -> String<48> {
        active_network(&self.slots, self.verified).map_or_else(|_| String::new(), |network| network.into_header().name)
    }
}

/// The network that runs.
fn active_network<F: MappedFlash>(slots: &Slots<F>, verified: Option<Verified>) -> Result<Network<'_>, Refusal> {
    let (file, verified) = slots.active_file().zip(verified).ok_or(Refusal::NoNetwork)?;
    verified.open(file).map_err(Refusal::Blob)
}
