//! A run from its lease to its version.

use evermap_schemas::Fault;

use crate::map::lease::Lease;
use crate::map::newest;
use crate::map::sound::Sound;
use crate::map::version::{Previous, Version};
use crate::run::driver::Driver;
use crate::run::runner::Runner;
use crate::run::{Event, Run, RunEnd, RunResult};

/// How often the units of a run are gone through, when files that they left keep vanishing.
const ROUNDS: usize = 3;

impl Run<'_> {
    /// Runs everything, then publishes.
    ///
    /// # Errors
    /// The first unit's fault, after the units that were under way have ended; what was done stays done.
    pub async fn execute(
        &self,
        runner: &dyn Runner,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<RunEnd, Fault> {
        if self.sessions.is_empty() {
            let fault = "expected sessions, given or in the map, found none";
            return Err(Fault::user(fault)
                .next("give some with --sessions FILES, of which a step of the plan reads a role or a topic"));
        }
        let lease = Lease::of_run(self.store).await?;
        let ended = self.rounds(&lease, runner, observe).await;
        lease.end().await;
        match ended {
            // What a version needs may go when a newer one is there, so that is looked for first.
            Err(fault) => match self.overtaking().await? {
                Some(by) => Ok(RunEnd::Overtaken { by }),
                None => Err(fault),
            },
            ended => ended,
        }
    }

    /// What `previous` means in this run.
    ///
    /// # Errors
    /// As [`Previous::of`].
    pub fn previous(&self) -> Result<Previous, Fault> {
        Previous::of(self.program, self.sessions, self.base)
    }

    /// Runs the units, and those anew whose rows have vanished since, until all are there at once.
    async fn rounds(
        &self,
        lease: &Lease,
        runner: &dyn Runner,
        observe: &mut (dyn FnMut(Event<'_>) + Send),
    ) -> Result<RunEnd, Fault> {
        let mut round = 1;
        loop {
            let mut driver = Driver::new(self, lease, Sound::load(self.store).await?)?;
            observe(Event::Planned {
                units: driver.units(),
            });
            let driven = driver.drive(runner, observe).await;
            driver.sound.remember().await?;
            let gone = driver.gone().await?;
            if gone.is_empty() || round == ROUNDS {
                driven?;
                return match gone.into_iter().next() {
                    Some(damage) => Err(damage.into()),
                    None => self.publish(driver).await,
                };
            }
            for damage in gone {
                tracing::warn!("{damage}: it was there when this run began; it is made anew");
            }
            round += 1;
        }
    }

    async fn publish(&self, driver: Driver<'_, '_>) -> Result<RunEnd, Fault> {
        let parent = self.parent();
        let version = Version {
            version: Version::number_after(self.store, parent).await?,
            parent,
            program: self.program.digest()?,
            previous: driver.previous.clone(),
            plan: self.program.plan.clone(),
            evermap: env!("CARGO_PKG_VERSION").to_owned(),
            published: chrono::Utc::now().to_rfc3339(),
            sessions: self.sessions.to_vec(),
            layers: driver.layers()?,
            losses: driver.losses(),
        };
        let (version, published) = match self.base {
            Some(base) if base.same_content(&version) => (base.clone(), false),
            _ if version.publish(self.store).await? => (version, true),
            _ => {
                let by = version.version;
                return Ok(RunEnd::Overtaken { by });
            }
        };
        newest::link(self.store, &version).await;
        Ok(RunEnd::Done(Box::new(RunResult {
            version,
            published,
            units: driver.done(),
        })))
    }

    /// The version that this run began with; 0 for none.
    fn parent(&self) -> u64 {
        self.base.map_or(0, |base| base.version)
    }

    /// A version that another run has published since this one began.
    async fn overtaking(&self) -> Result<Option<u64>, Fault> {
        let latest = Version::latest(self.store).await?;
        let newer = latest.filter(|latest| latest.version > self.parent());
        Ok(newer.map(|newer| newer.version))
    }
}
