//! Somebody on the bus who says rubbish on every topic: nobody panics, nothing forbidden is commanded, and what was
//! refused is counted.

use bytemuck::bytes_of_mut;
use messages::topics::{
    ACTIVE, BELIEF, BOXES, CANDIDATES, COMMANDS, CONTROL, CYCLES, DECISIONS, HEALTH, MOTIONS, Role,
};
use messages::{CandidateSet, Decision, Message};
use packing::Draw;
use runtime::{Bus, Publisher, monotonic_ns};

use crate::harness::{Services, wait_until};

const SETTINGS: &str = "[perception]\npace_ms = 2\n[scorer]\npolicy = \"walle\"\n";

/// Messages of random bytes that are said on each topic.
const MESSAGES: u64 = 30;

/// Says random bytes on a topic, with stamps from the past and the future.
fn babble<M: Message>(publisher: &mut Publisher<M>, draw: &mut Draw) {
    for _ in 0..MESSAGES {
        let observed_ns = [0, monotonic_ns(), u64::MAX][draw.below(3) as usize];
        // Small numbers too: they are what counts and lists are made of.
        let below = [2, 8, 256][draw.below(3) as usize];
        let fill = |message: &mut M| bytes_of_mut(message).iter_mut().for_each(|byte| *byte = draw.below(below) as u8);
        publisher.publish(observed_ns, fill).unwrap();
    }
}

#[test]
fn rubbish_beside_a_running_cell_stops_nothing() {
    let mut cell = Services::new("hostile", SETTINGS);
    ["candidates", "scorer", "commander", "perception"].into_iter().for_each(|name| cell.start(name));
    cell.await_progress("the cell packs");
    let bus = Bus::join(&cell.bus_config(), Role::Tool).unwrap();
    let mut draw = Draw::new(602, 1, 0);
    babble(&mut bus.publisher(&CANDIDATES).unwrap(), &mut draw);
    babble(&mut bus.publisher(&DECISIONS).unwrap(), &mut draw);
    babble(&mut bus.publisher(&CONTROL).unwrap(), &mut draw);
    babble(&mut bus.publisher(&HEALTH).unwrap(), &mut draw);
    answer_wrongly(&bus, &mut draw);
    propose_wrongly(&bus, &mut draw);
    cell.await_progress("the cell packs on");
    wait_until("the refusals are counted", || (cell.refused("commander")? > 0).then_some(()));
    wait_until("the refusals are counted", || (cell.refused("scorer")? > 0).then_some(()));
    cell.assert_all_run();
}

/// Answers real sets as instances `a` to `h`, with indices, values and revisions that are none.
fn answer_wrongly(bus: &Bus, draw: &mut Draw) {
    let sets = bus.subscriber(&CANDIDATES).unwrap();
    let mut decisions = bus.publisher(&DECISIONS).unwrap();
    let mut answered = 0;
    wait_until("real sets were answered wrongly", || {
        while let Some(set) = sets.receive().unwrap() {
            let nonsense = [
                (set.count, 1.0, set.revision),
                (u32::MAX, 1.0, set.revision),
                (0, f32::NAN, set.revision),
                (0, f32::NEG_INFINITY, set.revision),
                (0, 1.0, set.revision.wrapping_sub(1)),
            ];
            let (best, value, revision) = nonsense[draw.below(5) as usize];
            let instance = [0, 1, 7, 8, u32::MAX][draw.below(5) as usize];
            let (box_id, set_digest) = (set.current.id, set.digest);
            let build = |decision: &mut Decision| {
                (decision.box_id, decision.revision, decision.set_digest) = (box_id, revision, set_digest);
                (decision.instance, decision.best, decision.value) = (instance, best, value);
            };
            decisions.publish(u64::MAX, build).unwrap();
            answered += 1;
        }
        (answered > 50).then_some(())
    });
}

/// Proposes candidates that are none for the boxes that lie there, on the present revision and with a right digest.
fn propose_wrongly(bus: &Bus, draw: &mut Draw) {
    let real = bus.subscriber(&CANDIDATES).unwrap();
    let mut sets = bus.publisher(&CANDIDATES).unwrap();
    let own = draw.below(u64::MAX) | 1;
    let mut proposed = 0;
    wait_until("real sets were followed by wrong ones", || {
        while let Some(set) = real.receive().unwrap() {
            if set.received_ns == own {
                continue;
            }
            let mut candidates = Vec::new();
            set.read_candidates(&mut candidates).unwrap();
            for candidate in &mut candidates {
                let placement = &mut candidate.placement;
                let fields = [&mut placement.slot, &mut placement.i, &mut placement.j, &mut placement.base];
                let field = draw.below(4) as usize;
                fields.into_iter().skip(field).take(1).for_each(|field| *field = draw.below(1 << 16) as u16);
            }
            candidates.truncate(draw.below(3) as usize);
            let build = |wrong: &mut CandidateSet| {
                *wrong = *set;
                wrong.received_ns = own;
                wrong.write_candidates(&candidates);
            };
            sets.publish(0, build).unwrap();
            proposed += 1;
        }
        (proposed > 50).then_some(())
    });
}

#[test]
fn an_impostor_in_the_place_of_a_service_harms_nobody() {
    let mut cell = Services::new("impostor", SETTINGS);
    ["candidates", "scorer", "commander"].into_iter().for_each(|name| cell.start(name));
    wait_until("the commander speaks", || cell.refused("commander"));
    let mut draw = Draw::new(602, 2, 0);
    {
        let bus = Bus::join(&cell.bus_config(), Role::Tool).unwrap();
        let mut beliefs = bus.publisher(&BELIEF).unwrap();
        let mut queues = bus.publisher(&BOXES).unwrap();
        let mut motions = bus.publisher(&MOTIONS).unwrap();
        // A motion wakes the commander. Of the others it sees only the last, which may happen to make sense.
        wait_until("the refusals are counted", || {
            babble(&mut beliefs, &mut draw);
            babble(&mut queues, &mut draw);
            babble(&mut motions, &mut draw);
            (cell.refused("commander")? > 0).then_some(())
        });
    }
    cell.assert_all_run();
    cell.start("perception");
    cell.await_progress("the cell packs when the impostor is gone");
    cell.kill("commander");
    {
        let bus = Bus::join(&cell.bus_config(), Role::Tool).unwrap();
        // Whoever was killed holds its place until somebody cleans up after it.
        let mut commands = wait_until("the commander's place is free", || bus.publisher(&COMMANDS).ok());
        babble(&mut commands, &mut draw);
        babble(&mut bus.publisher(&CYCLES).unwrap(), &mut draw);
        babble(&mut bus.publisher(&ACTIVE).unwrap(), &mut draw);
    }
    cell.start("commander");
    cell.await_progress("the cell packs with its own commander");
    cell.assert_all_run();
}
