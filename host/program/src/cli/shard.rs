//! Which share of the work a run has: as the user says, or as the cluster's scheduler does.

use std::str::FromStr;

/// Variables of schedulers that number the tasks of an array and say how many there are: number, first, last, step.
const ARRAYS: [[&str; 4]; 2] = [
    ["SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_MAX", "SLURM_ARRAY_TASK_STEP"],
    ["SGE_TASK_ID", "SGE_TASK_FIRST", "SGE_TASK_LAST", "SGE_TASK_STEPSIZE"],
];
/// Variables of schedulers that number tasks from 0 and do not say how many there are: PBS, Kubernetes, HyperQueue.
const NUMBERS: [&str; 4] = ["PBS_ARRAY_INDEX", "PBS_ARRAYID", "JOB_COMPLETION_INDEX", "HQ_TASK_ID"];

/// Parses `I/N`, `auto` or `auto/N`. `first` is what the verb counts from.
///
/// # Errors
/// The text is none of these, or no scheduler says what `auto` asks for.
pub(super) fn shard<T: FromStr<Err = String>>(text: &str, first: usize) -> Result<T, String> {
    let asked = match text.strip_prefix("auto") {
        None => return text.parse(),
        Some("") => None,
        Some(rest) => {
            let number = rest.strip_prefix('/').and_then(|n| n.parse::<usize>().ok()).filter(|n| *n > 0);
            Some(number.ok_or("expected auto or auto/N, e.g. auto/8")?)
        }
    };
    let variable = |name: &str| std::env::var(name).ok();
    let (index, count) = scheduled(asked, &variable)?;
    format!("{}/{count}", index + first).parse()
}

/// The number of this task, from 0, and the number of tasks, by the variables of a scheduler.
fn scheduled(asked: Option<usize>, variable: &dyn Fn(&str) -> Option<String>) -> Result<(usize, usize), String> {
    let number = |name: &str| variable(name).and_then(|v| v.trim().parse::<usize>().ok());
    for [id, first, last, step] in ARRAYS {
        let Some(id_is) = number(id) else { continue };
        let (Some(first_is), Some(last_is)) = (number(first), number(last)) else {
            return Err(format!("{id} is {id_is}, but {first} and {last} are missing: give --shard I/N"));
        };
        let step = number(step).filter(|s| *s > 0).unwrap_or(1);
        if !(first_is..=last_is).contains(&id_is) {
            return Err(format!("{id} is {id_is}, outside {first_is} to {last_is}: give --shard I/N"));
        }
        let count = (last_is - first_is) / step + 1;
        return match asked {
            Some(n) if n != count => Err(format!("auto/{n}, but the scheduler runs {count} tasks ({last}, {first})")),
            _ => Ok(((id_is - first_is) / step, count)),
        };
    }
    for name in NUMBERS {
        let Some(index) = number(name) else { continue };
        return match asked {
            None => {
                Err(format!("{name} is {index}, but the scheduler does not say how many tasks there are: give auto/N"))
            }
            Some(n) if index >= n => {
                Err(format!("{name} is {index}, but auto/{n} counts from 0 to {}: number the tasks so", n - 1))
            }
            Some(n) => Ok((index, n)),
        };
    }
    // Tasks of one job, without an array.
    match number("SLURM_PROCID").zip(number("SLURM_NTASKS")) {
        Some((index, count)) if index < count => Ok((index, count)),
        _ => Err("no scheduler has set SLURM_ARRAY_TASK_ID, SGE_TASK_ID, PBS_ARRAY_INDEX, JOB_COMPLETION_INDEX or \
                  HQ_TASK_ID: give --shard I/N"
            .into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(variables: &[(&str, &str)], asked: Option<usize>) -> Result<(usize, usize), String> {
        let find = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, v)| v.to_string());
        scheduled(asked, &find)
    }

    #[test]
    fn each_scheduler_is_understood() {
        let slurm = |id, min, max, step| {
            let names = ARRAYS[0];
            with(&[(names[0], id), (names[1], min), (names[2], max), (names[3], step)], None)
        };
        assert_eq!(slurm("3", "0", "7", "1"), Ok((3, 8)));
        assert_eq!(slurm("8", "1", "8", "1"), Ok((7, 8)));
        assert_eq!(slurm("14", "10", "16", "2"), Ok((2, 4)));
        assert!(slurm("9", "1", "8", "1").is_err());
        let sge = [("SGE_TASK_ID", "1"), ("SGE_TASK_FIRST", "1"), ("SGE_TASK_LAST", "5"), ("SGE_TASK_STEPSIZE", "1")];
        assert_eq!(with(&sge, None), Ok((0, 5)));
        assert!(with(&sge, Some(4)).unwrap_err().contains("runs 5 tasks"));
        for name in NUMBERS {
            assert_eq!(with(&[(name, "2")], Some(3)), Ok((2, 3)));
            assert!(with(&[(name, "2")], None).unwrap_err().contains("give auto/N"));
            assert!(with(&[(name, "3")], Some(3)).unwrap_err().contains("from 0 to 2"));
        }
        assert_eq!(with(&[("SLURM_PROCID", "1"), ("SLURM_NTASKS", "4")], None), Ok((1, 4)));
        // SGE sets this outside of arrays.
        assert!(with(&[("SGE_TASK_ID", "undefined")], None).unwrap_err().contains("give --shard I/N"));
    }

    #[test]
    fn a_share_may_be_given_by_hand() {
        use ommatidia_model::dataset::Share;
        assert_eq!(shard::<Share>("2/3", 1).map(|s| s.to_string()), Ok("2/3".into()));
        assert!(shard::<Share>("auto/x", 1).is_err() && shard::<Share>("0/3", 1).is_err());
    }
}
