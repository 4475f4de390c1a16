use super::*;

fn need(step: &str, inputs: &[Input], of_session: bool) -> Need {
    Need {
        step: step.to_owned(),
        inputs: inputs.to_vec(),
        is_query: false,
        of_session,
    }
}

fn source(name: &str) -> Input {
    Input::Source(name.to_owned())
}

fn step(name: &str) -> Input {
    Input::Step(name.to_owned())
}

fn roles(names: &[&str]) -> Roles {
    names.iter().map(ToString::to_string).collect()
}

fn of(steps: Vec<Need>) -> Needs {
    Needs {
        steps,
        whole: Lacks::new(),
    }
}

fn lifelong() -> Needs {
    of(vec![
        need("keyframes", &[source("odometry")], true),
        need("features", &[step("keyframes"), source("frames")], true),
        need("poses", &[step("features")], false),
        need("labels", &[step("poses"), source("annotations")], false),
    ])
}

#[test]
fn a_session_is_of_use_where_a_step_that_reads_it_is_fed() {
    let drive = roles(&["odometry", "frames"]);
    assert_eq!(lifelong().lacks(&drive, &drive), None);
    // Keyframes are made of odometry alone.
    let blind = roles(&["odometry"]);
    assert_eq!(lifelong().lacks(&blind, &blind), None);
    let images = roles(&["frames"]);
    let lacks = Lacks::from([("odometry".to_owned(), "keyframes".to_owned())]);
    assert_eq!(lifelong().lacks(&images, &images), Some(lacks.clone()));
    assert_eq!(lifelong().lacks(&images, &drive), Some(lacks));
}

#[test]
fn what_people_said_is_of_use_beside_a_drive_and_not_alone() {
    let said = roles(&["annotations"]);
    let all = roles(&["annotations", "odometry", "frames"]);
    assert_eq!(lifelong().lacks(&said, &all), None);
    let alone = lifelong().lacks(&said, &said).unwrap_or_default();
    assert_eq!(
        in_words(&alone),
        "frames (step features), odometry (step keyframes)"
    );
}

#[test]
fn a_session_that_plays_some_of_what_a_plan_needs_must_play_all() {
    let mut needs = lifelong();
    let whole = [("odometry", "keyframes"), ("frames", "features")];
    needs.whole = Lacks::from(whole.map(|(role, step)| (role.to_owned(), step.to_owned())));
    let drive = roles(&["odometry", "frames"]);
    assert_eq!(needs.lacks(&drive, &drive), None);
    let blind = roles(&["odometry"]);
    let lacks = Lacks::from([("frames".to_owned(), "features".to_owned())]);
    assert_eq!(needs.lacks(&blind, &drive), Some(lacks));
    // A file that is inspected is alone.
    let told = |plays: &Roles| needs.lacks_alone(plays).map(|lacks| in_words(&lacks));
    assert_eq!(told(&drive), None);
    assert_eq!(told(&blind).as_deref(), Some("frames (step features)"));
    let whole = "frames (step features), odometry (step keyframes)";
    assert_eq!(told(&roles(&["annotations"])).as_deref(), Some(whole));
    // It is no drive, and says where labels are.
    let said = roles(&["annotations"]);
    let all = roles(&["annotations", "odometry", "frames"]);
    assert_eq!(needs.lacks(&said, &all), None);
}

#[test]
fn a_log_that_plays_nothing_is_told_all_that_is_lacking() {
    let lacks = lifelong()
        .lacks(&Roles::new(), &Roles::new())
        .unwrap_or_default();
    assert_eq!(lacks.len(), 3);
}

#[test]
fn a_query_is_content_with_one_table_and_topics_are_taken_at_their_word() {
    let needs = |inputs: &[Input]| {
        of(vec![Need {
            is_query: true,
            ..need("rows", inputs, false)
        }])
    };
    let odometry = roles(&["odometry"]);
    let either = needs(&[source("odometry"), source("frames")]);
    assert_eq!(either.lacks(&odometry, &odometry), None);
    let topic = needs(&[source("/battery")]);
    assert_eq!(topic.lacks(&Roles::new(), &Roles::new()), None);
}

#[test]
fn what_is_only_kept_for_other_steps_makes_nothing_of_a_session() {
    let cameras = Need {
        is_query: true,
        ..need("cameras", &[source("calibration")], true)
    };
    let mut needs = lifelong();
    needs.steps.insert(0, cameras);
    needs
        .steps
        .push(need("tracks", &[step("cameras"), step("features")], true));
    let images = roles(&["frames", "calibration"]);
    let lacks = needs.lacks(&images, &images).unwrap_or_default();
    assert_eq!(in_words(&lacks), "odometry (step keyframes)");
    // Where nobody reads it, it is what the plan is for.
    needs.steps.pop();
    assert_eq!(needs.lacks(&images, &images), None);
}
