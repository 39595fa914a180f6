//! What the kernel grants this process: its scheduling policy, its processors, and memory that stays.
//!
//! Real time is asked for from outside, by the unit that starts the process, and a kernel may give less than was
//! asked without a word. So every process reads back what it has, says it once, and runs on with it.

use std::fs;

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, getrlimit};

/// Keeps the process's memory from being paged out if its unit allows that without a limit, and logs what it has.
///
/// With a limit, memory is not locked: a mapping beyond the limit would fail in the middle of the work.
pub(crate) fn settle() {
    let limit = getrlimit(Resource::Memlock).current;
    let memory = match limit {
        None => match mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE) {
            Ok(()) => "locked".to_owned(),
            Err(error) => format!("not locked ({error})"),
        },
        Some(bytes) => format!("not locked (its limit is {} KiB)", bytes / 1024),
    };
    let read = |name: &str| fs::read_to_string(format!("/proc/self/{name}")).unwrap_or_default();
    let (policy, cpus) = (policy(&read("stat")), cpus(&read("status")));
    tracing::info!("granted by the kernel: {policy} on processors {cpus}, memory {memory}");
}

/// The scheduling policy and its priority in `/proc/self/stat`.
fn policy(stat: &str) -> String {
    // The second field, the program's name, may hold anything but ends at the last parenthesis; the third is first here.
    let fields: Vec<&str> = stat.rsplit_once(") ").map_or(vec![], |(_, fields)| fields.split(' ').collect());
    let field = |number: usize| fields.get(number - 3).copied().unwrap_or("?");
    let (priority, nice) = (field(40), field(19));
    match field(41) {
        "0" => format!("other, nice {nice}"),
        "1" => format!("fifo {priority}"),
        "2" => format!("round robin {priority}"),
        "3" => format!("batch, nice {nice}"),
        "5" => "idle".to_owned(),
        "6" => "deadline".to_owned(),
        policy => format!("number {policy}"),
    }
}

/// The processors on which it may run, in `/proc/self/status`.
fn cpus(status: &str) -> String {
    status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).map_or("?", str::trim).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line of `/proc/PID/stat` with this nice value, real-time priority and policy.
    fn stat(nice: i32, priority: u32, number: u32) -> String {
        let until_nice = "R 1 1 1 0 -1 4194304 100 0 0 0 5 5 0 0 20";
        let until_priority = "1 0 100 1000 100 18446744073709551615 1 1 1 1 1 0 0 0 0 0 0 0 17 3";
        format!("42 (a) b) {until_nice} {nice} {until_priority} {priority} {number} 0 0 0")
    }

    #[test]
    fn policies_are_read_back() {
        assert_eq!(policy(&stat(-5, 0, 0)), "other, nice -5");
        assert_eq!(policy(&stat(0, 20, 1)), "fifo 20");
        assert_eq!(policy(&stat(0, 9, 2)), "round robin 9");
        assert_eq!(policy("nonsense"), "number ?");
        let own = policy(&fs::read_to_string("/proc/self/stat").unwrap());
        assert!(!own.contains('?'), "{own}");
    }

    #[test]
    fn processors_are_read_back() {
        assert_eq!(cpus("Threads:\t1\nCpus_allowed_list:\t0-1,3\n"), "0-1,3");
        assert_eq!(cpus(""), "?");
        assert_ne!(cpus(&fs::read_to_string("/proc/self/status").unwrap()), "?");
    }
}
