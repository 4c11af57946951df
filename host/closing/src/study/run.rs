//! A whole study: instruments, cases, figures.

use super::networks::Networks;
use super::plan::{Case, cases, has_key, instruments_of};
use super::record::{Ledger, Outcome, read_all};
use super::sealed::Sealed;
use super::sensitivity::Sensitivities;
use super::shard::Shard;
use super::size::Size;
use super::subject::Subject;
use super::summary::Summary;
use super::text::{Plan, page};
use super::{trial, unknown};
use anyhow::{Context, bail};
use ommatidia_model::calibrate::CalibrateError;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// File of the figures.
pub const JSON: &str = "study.json";
/// File of the plan.
pub const PLAN: &str = "plan.json";
/// File of the page.
pub const PAGE: &str = "study.md";

/// The result of a study.
pub struct Study {
    /// All sessions, including those of earlier runs into the same folder.
    pub outcomes: Vec<Outcome>,
    /// The figures.
    pub summary: Summary,
}

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct StudyRequest<'a> {
    /// Folder of the outcomes, figures and page.
    pub dir: &'a Path,
    /// Size of the study.
    pub size: &'a Size,
    /// The share of the instruments to run.
    pub shard: Shard,
    /// Counter of the sealed seeds, for a study of those.
    pub sealed: Option<&'a Path>,
    /// Only the sessions whose key holds this text; the others stay planned.
    pub keys: &'a str,
}

/// How far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Cases that are done.
    pub done: usize,
    /// Cases of this run.
    pub planned: usize,
}

/// Runs the cases of a study that belong to the shard and have no outcome in the folder yet, then writes figures and
/// page of all outcomes in the folder. `progress` is called after each case.
///
/// The instruments of the shard that have such sessions are calibrated first, then one after the other closes all its
/// sessions, in parallel and each on one thread; the outcome does not depend on the number of threads.
///
/// # Errors
/// No session has such a key, the folder cannot be written, it holds another study, or no instrument can be calibrated.
/// An instrument that `calibrate` refuses is left out and counted. A session that cannot be closed is not an error: its
/// outcome holds the reason.
pub fn run(
    request: &StudyRequest<'_>,
    networks: &dyn Networks,
    progress: impl Fn(Progress) + Sync,
) -> anyhow::Result<Study> {
    let StudyRequest { dir, size, shard, sealed, keys } = *request;
    if !has_key(size, keys) {
        bail!(
            "no session of this study has a key that contains {keys:?}; study.json has the keys of sessions that ran"
        );
    }
    std::fs::create_dir_all(dir).with_context(|| dir.display().to_string())?;
    let size = &begin(dir, size, shard, sealed)?;
    let opened = size.sealed.then_some(size.opening);
    let numbers: Vec<u64> = instruments_of(size, keys).into_iter().filter(|n| shard.has(*n as usize)).collect();
    // Their foci take much memory, so only what is on disk is kept.
    let prepared = |n: &u64| match Subject::prepare(*n, size, dir, networks) {
        Err(e) if e.downcast_ref::<CalibrateError>().is_some() => {
            tracing::warn!("instrument {n} is left out: {e:#}");
            Ok(Some(*n))
        }
        other => other.map(|_| None),
    };
    let refused = side_by_side(&numbers, prepared)?.into_iter().collect::<anyhow::Result<Vec<Option<u64>>>>()?;
    let refused: Vec<u64> = refused.into_iter().flatten().collect();
    if !numbers.is_empty() && refused.len() == numbers.len() {
        bail!("`calibrate` refuses all {} instruments; the log has the reasons", numbers.len());
    }
    let sensitivities: Vec<Option<Sensitivities>> = (0..size.instruments).map(|n| Subject::known(n, dir)).collect();
    let ended: BTreeSet<String> = read_all(dir)?.into_iter().map(|o| o.case.key).collect();
    let all = cases(size, &sensitivities);
    let planned = all.len();
    let mine = |c: &Case| shard.has(c.instrument as usize) && !ended.contains(&c.key) && c.key.contains(keys);
    let todo: Vec<Case> = all.into_iter().filter(mine).collect();
    let ledger = Ledger::open(dir, shard)?;
    let done = AtomicUsize::new(0);
    for n in numbers.into_iter().filter(|n| !refused.contains(n)) {
        let of_this: Vec<&Case> = todo.iter().filter(|c| c.instrument == n).collect();
        if of_this.is_empty() {
            continue;
        }
        let subject = Subject::prepare(n, size, dir, networks)?;
        let one = |case: &&Case| -> std::io::Result<()> {
            ledger.push(&trial::run(&subject, case, networks))?;
            progress(Progress { done: done.fetch_add(1, Ordering::Relaxed) + 1, planned: todo.len() });
            Ok(())
        };
        side_by_side(&of_this, one)?
            .into_iter()
            .collect::<std::io::Result<Vec<()>>>()
            .with_context(|| dir.display().to_string())?;
    }
    conclude(
        dir,
        size,
        Plan { planned, opened, refused: refused.len() },
        &sensitivities.into_iter().flatten().collect::<Vec<_>>(),
    )
}

/// Checks that the folder holds no other study, and counts an opening of the sealed seeds where this is one. Returns
/// the size with the number of the sealed study.
pub(super) fn begin(dir: &Path, size: &Size, shard: Shard, sealed: Option<&Path>) -> anyhow::Result<Size> {
    let file = dir.join(PLAN);
    let known = std::fs::read(&file).ok().map(|known| serde_json::from_slice::<Size>(&known).ok());
    if let Some(known) = known {
        return match known {
            // A study that goes on opens nothing new.
            Some(known) if Size { opening: known.opening, ..size.clone() } == known => Ok(known),
            _ => bail!(
                "{}: the folder holds a study of another size or other seeds; name another folder",
                file.display()
            ),
        };
    }
    let opening = match (size.sealed, sealed) {
        (false, _) => 0,
        (true, None) => bail!("sealed seeds need a counter of how often they were opened"),
        // Nor does another share of it.
        (true, Some(counter)) if shard.index > 0 => Sealed::read(counter)?.opened,
        (true, Some(counter)) => Sealed::open(counter)?.opened,
    };
    let size = Size { opening, ..size.clone() };
    ommatidia_session::artifact::write_whole(&file, &serde_json::to_vec_pretty(&size)?)?;
    Ok(size)
}

/// Writes figures and page of all sessions in a folder.
fn conclude(dir: &Path, size: &Size, plan: Plan, sensitivities: &[Sensitivities]) -> anyhow::Result<Study> {
    let outcomes = read_all(dir)?;
    let summary = Summary::of(&outcomes);
    let json = serde_json::json!({
        "size": size, "planned": plan.planned, "opened": plan.opened, "sensitivities": sensitivities,
        "summary": summary, "sessions": outcomes,
    });
    ommatidia_session::artifact::write_whole(&dir.join(JSON), &serde_json::to_vec_pretty(&json)?)?;
    let page = match size.is_of_unknown_specimens() {
        true => unknown::page(plan, sensitivities, &outcomes, &summary),
        false => page(size, plan, sensitivities, &outcomes, &summary),
    };
    ommatidia_session::artifact::write_whole(&dir.join(PAGE), page.as_bytes())?;
    Ok(Study { outcomes, summary })
}

/// Calls `each` for all items, one item per thread of the pool; the parallel parts of an item run on its own thread, so
/// they never wait for another item. Results are in the order of the items.
fn side_by_side<T: Sync, R: Send>(items: &[T], each: impl Fn(&T) -> R + Sync) -> anyhow::Result<Vec<R>> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::new());
    let work = || -> anyhow::Result<()> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(i) else { return Ok(()) };
            let result = pool.install(|| each(item));
            results.lock().unwrap_or_else(PoisonError::into_inner).push((i, result));
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..rayon::current_num_threads().max(1)).map(|_| scope.spawn(work)).collect();
        for t in threads {
            match t.join() {
                Ok(result) => result?,
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        anyhow::Ok(())
    })?;
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(i, _)| *i);
    Ok(results.into_iter().map(|(_, r)| r).collect())
}
