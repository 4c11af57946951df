//! Work without the global lock: threads, progress, and Ctrl-C.

use crate::error::raised;
use anyhow::Context;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::Result as Finished;
use std::time::Duration;

/// How often a waiting Python thread looks for signals.
const SIGNALS_EVERY: Duration = Duration::from_millis(50);
/// Stack of each thread, bytes: that of the program's main thread, on which the verbs run.
const STACK_BYTES: usize = 8 << 20;

/// The threads of this process: its number, its threads, and how many were asked for (0: one a core).
struct Threads {
    process: u32,
    pool: Option<Arc<ThreadPool>>,
    count: usize,
}

static THREADS: Mutex<Threads> = Mutex::new(Threads { process: 0, pool: None, count: 0 });

/// The threads that all work runs on. A process that was forked (as workers of PyTorch's `DataLoader` are) has none of
/// its parent's threads, so it starts its own.
fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut threads = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if threads.process != process {
        // To end threads that are not there would wait for ever.
        if let Some(ended) = threads.pool.take() {
            std::mem::forget(ended);
        }
        threads.process = process;
    }
    if let Some(pool) = &threads.pool {
        return Ok(Arc::clone(pool));
    }
    let built = ThreadPoolBuilder::new().num_threads(threads.count).stack_size(STACK_BYTES).build();
    let pool = Arc::new(built.context("the threads cannot be started").map_err(raised)?);
    threads.pool = Some(Arc::clone(&pool));
    Ok(pool)
}

/// Sets the number of threads that work runs on; 0: one for each core. No result depends on it.
#[pyfunction]
pub fn set_threads(count: u16) {
    let mut threads = THREADS.lock().unwrap_or_else(PoisonError::into_inner);
    threads.count = count.into();
    if threads.process == std::process::id() {
        // Work that still runs keeps its threads until it ends.
        threads.pool = None;
    }
}

/// Runs short work on the threads, without the global lock.
///
/// # Errors
/// The threads cannot be started, or the work fails.
pub fn short<T: Send>(py: Python<'_>, job: impl FnOnce() -> anyhow::Result<T> + Send) -> PyResult<T> {
    let pool = pool()?;
    py.detach(|| pool.install(job)).map_err(raised)
}

/// What long work reports to the thread that waits for it.
enum Message<T> {
    Step(Step),
    End(Finished<anyhow::Result<T>>),
}

/// A step of long work.
struct Step {
    name: String,
    done: u64,
    total: Option<u64>,
}

/// Steps of long work: reports them, and ends the work where it was stopped.
pub struct Steps<'a> {
    report: &'a (dyn Fn(Step) + Sync),
    stop: &'a AtomicBool,
}

/// What unwinds work that was stopped.
struct Stopped;

impl Steps<'_> {
    /// A step begins or ends: its name, and how many of how many are done.
    pub fn at(&self, name: &str, done: u64, total: Option<u64>) {
        if self.stop.load(Ordering::Relaxed) {
            // No panic hook runs: nothing is printed.
            resume_unwind(Box::new(Stopped));
        }
        (self.report)(Step { name: name.into(), done, total });
    }
}

/// Runs long work on the threads while this thread calls `progress(name, done, total)` and looks for signals. Where a
/// signal (Ctrl-C) or `progress` raises, the exception goes on at once; the work ends at its next step.
///
/// # Errors
/// The threads cannot be started, the work fails, or an exception was raised meanwhile.
pub fn long<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<Bound<'_, PyAny>>,
    job: impl FnOnce(&Steps<'_>) -> anyhow::Result<T> + Send + 'static,
) -> PyResult<T> {
    let (send, mut receive): (Sender<Message<T>>, Receiver<Message<T>>) = channel();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    pool()?.spawn(move || {
        // Where nobody waits any more, nobody needs the message.
        let report = |step| drop(send.send(Message::Step(step)));
        let steps = Steps { report: &report, stop: &stopped };
        let end = catch_unwind(AssertUnwindSafe(|| job(&steps)));
        drop(send.send(Message::End(end)));
    });
    wait(py, progress, &mut receive).inspect_err(|_| stop.store(true, Ordering::Relaxed))
}

fn wait<T: Send>(
    py: Python<'_>,
    progress: Option<Bound<'_, PyAny>>,
    receive: &mut Receiver<Message<T>>,
) -> PyResult<T> {
    loop {
        let receive = &mut *receive;
        let message = py.detach(move || receive.recv_timeout(SIGNALS_EVERY));
        py.check_signals()?;
        match message {
            Ok(Message::Step(step)) => {
                if let Some(progress) = &progress {
                    progress.call1((step.name, step.done, step.total))?;
                }
            }
            Ok(Message::End(Ok(result))) => return result.map_err(raised),
            Ok(Message::End(Err(panic))) => resume_unwind(panic),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Err(raised(anyhow::anyhow!("the work was lost"))),
        }
    }
}
