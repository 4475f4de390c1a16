use super::*;

fn need(step: &str, inputs: &[Input], of_session: bool) -> Need {
    let reads = inputs.iter().map(|input| (input.clone(), false));
    Need::of(step, reads, false, of_session)
}

/// What a session lacks whose site shares nothing.
fn missing(needs: &Needs, plays: &Roles, all: &Roles) -> Option<Lacks> {
    needs.lacks(plays, all, &Roles::new())
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
    assert_eq!(missing(&lifelong(), &drive, &drive), None);
    // Keyframes are made of odometry alone.
    let blind = roles(&["odometry"]);
    assert_eq!(missing(&lifelong(), &blind, &blind), None);
    let images = roles(&["frames"]);
    let lacks = Lacks::from([("odometry".to_owned(), "keyframes".to_owned())]);
    assert_eq!(missing(&lifelong(), &images, &images), Some(lacks.clone()));
    assert_eq!(missing(&lifelong(), &images, &drive), Some(lacks));
}

#[test]
fn what_people_said_is_of_use_beside_a_drive_and_not_alone() {
    let said = roles(&["annotations"]);
    let all = roles(&["annotations", "odometry", "frames"]);
    assert_eq!(missing(&lifelong(), &said, &all), None);
    let alone = missing(&lifelong(), &said, &said).unwrap_or_default();
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
    assert_eq!(missing(&needs, &drive, &drive), None);
    let blind = roles(&["odometry"]);
    let lacks = Lacks::from([("frames".to_owned(), "features".to_owned())]);
    assert_eq!(missing(&needs, &blind, &drive), Some(lacks));
    // A file that is inspected is alone.
    let told = |plays: &Roles| needs.lacks_alone(plays).map(|lacks| in_words(&lacks));
    assert_eq!(told(&drive), None);
    assert_eq!(told(&blind).as_deref(), Some("frames (step features)"));
    let whole = "frames (step features), odometry (step keyframes)";
    assert_eq!(told(&roles(&["annotations"])).as_deref(), Some(whole));
    // It is no drive, and says where labels are.
    let said = roles(&["annotations"]);
    let all = roles(&["annotations", "odometry", "frames"]);
    assert_eq!(missing(&needs, &said, &all), None);
}

#[test]
fn a_session_that_lacks_the_one_role_that_a_plan_needs_is_of_no_use_beside_others() {
    let mut needs = of(vec![
        need("labels", &[source("label_frames")], true),
        need("spheres", &[source("depth_frames")], true),
        need("views", &[step("labels"), step("spheres")], false),
        need("said", &[source("annotations")], true),
    ]);
    needs.whole = Lacks::from([("label_frames".to_owned(), "labels".to_owned())]);
    let street = roles(&["label_frames", "depth_frames"]);
    assert_eq!(missing(&needs, &street, &street), None);
    let told = |plays: &[&str]| {
        let lacks = missing(&needs, &roles(plays), &street);
        lacks.map(|lacks| in_words(&lacks))
    };
    let lacks = Some("label_frames (step labels)".to_owned());
    assert_eq!(told(&["depth_frames"]), lacks);
    assert_eq!(told(&["depth_frames", "annotations"]), lacks);
    // People's labels are no drive.
    assert_eq!(told(&["annotations"]), None);
    // Of what the plan reads, neither a drive of another kind nor how a vehicle is built has anything.
    let nothing = missing(&needs, &Roles::new(), &street);
    assert_eq!(missing(&needs, &roles(&["imu"]), &street), nothing);
    assert_eq!(missing(&needs, &roles(&["calibration"]), &street), nothing);
}

#[test]
fn a_role_of_use_alone_says_that_a_session_is_a_drive() {
    let reads = [(source("odometry"), false), (source("frames"), true)];
    let mut needs = of(vec![Need::of("keyframes", reads.into_iter(), false, true)]);
    needs.whole = Lacks::from([("frames".to_owned(), "keyframes".to_owned())]);
    let drive = roles(&["odometry", "frames"]);
    assert_eq!(missing(&needs, &drive, &drive), None);
    // A step would do without: the plan does not.
    let blind = missing(&needs, &roles(&["odometry"]), &drive);
    assert_eq!(blind, Some(needs.whole.clone()));
    needs.whole = Lacks::from([("odometry".to_owned(), "keyframes".to_owned())]);
    let images = missing(&needs, &roles(&["frames"]), &drive);
    assert_eq!(images, Some(needs.whole.clone()));
}

#[test]
fn what_one_session_shares_the_others_of_its_site_need_not_have() {
    let mut needs = lifelong();
    needs.whole = Lacks::from([("gnss_fixes".to_owned(), "antenna_positions".to_owned())]);
    let inputs = [source("gnss_fixes"), step("keyframes")];
    needs.steps.push(need("antenna_positions", &inputs, true));
    let (drive, fixes) = (roles(&["odometry", "frames"]), roles(&["gnss_fixes"]));
    let all = roles(&["odometry", "frames", "gnss_fixes"]);
    assert_eq!(needs.lacks(&all, &all, &fixes), None);
    assert_eq!(needs.lacks(&drive, &all, &fixes), None);
    let elsewhere = needs.lacks(&drive, &all, &Roles::new());
    assert_eq!(elsewhere, Some(needs.whole.clone()));
}

#[test]
fn a_log_that_plays_nothing_is_told_all_that_is_lacking() {
    let lacks = missing(&lifelong(), &Roles::new(), &Roles::new()).unwrap_or_default();
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
    assert_eq!(missing(&either, &odometry, &odometry), None);
    let frames = || need("images", &[source("frames")], true);
    for any in ["/battery", "messages", "channels", "label_classes"] {
        let mut any_log = needs(&[source(any)]);
        assert_eq!(missing(&any_log, &Roles::new(), &Roles::new()), None);
        // Beside steps that need what nobody has, records of classes make nothing of a session.
        any_log.steps.push(frames());
        let lacks = missing(&any_log, &Roles::new(), &Roles::new());
        assert_eq!(lacks.is_some(), any == "label_classes", "{any}");
    }
    // Nothing at all is read.
    let nothing = needs(&[]);
    assert_eq!(missing(&nothing, &odometry, &odometry), Some(Lacks::new()));
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
    let lacks = missing(&needs, &images, &images).unwrap_or_default();
    assert_eq!(in_words(&lacks), "odometry (step keyframes)");
    // Where nobody reads it, it is what the plan is for.
    needs.steps.pop();
    assert_eq!(missing(&needs, &images, &images), None);
}
