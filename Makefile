# Each command sets up what it needs first. Options are variables: make evaluate DOMAIN=card EPISODES=20 KEYPOINTS=truth
SHELL := /bin/bash
.DELETE_ON_ERROR:

DOMAIN ?= card
EPISODES ?= 20
SEED ?= 0
KEYPOINTS ?= camera
OBJECT ?= default
CONTACTS ?=
ENGINE ?= mujoco
EFFECTS ?= none
GPUS ?=
BAG ?=
CASES ?= 200
SEEDS ?= 20
SET ?= locked
JOBS ?= $(shell nproc)
CLUSTER ?=
ON = $(if $(CLUSTER),--cluster $(CLUSTER))
ARGS ?=

# A name that is none of them would be passed over, and the command run with its defaults; so would one that its rule below does not name.
OPTIONS := DOMAIN EPISODES SEED KEYPOINTS OBJECT CONTACTS ENGINE EFFECTS GPUS BAG CASES SEEDS SET JOBS CLUSTER ARGS PYTEST_ARGS
OF_SETUP := PYTHON TORCH_INDEX SHELL
GIVEN := $(foreach v,$(.VARIABLES),$(if $(filter command,$(origin $v)),$v))
STRANGE := $(filter-out $(OPTIONS) $(OF_SETUP),$(GIVEN))
$(if $(STRANGE),$(error $(STRANGE): expected options among $(OPTIONS) $(OF_SETUP); `make help` lists each command's))
RULES = $(foreach goal,$(MAKECMDGOALS),sed -n '/^$(goal):/,/^$$/p' Makefile;)
UNUSED := $(if $(filter 0,$(MAKELEVEL)),$(filter-out $(OF_SETUP) $(if $(GIVEN),$(shell { $(RULES) } | grep -oE '[A-Z_]+')),$(GIVEN)))
$(if $(UNUSED),$(error $(UNUSED): `make $(or $(MAKECMDGOALS),help)` has no use for it; `make help` lists each command's options))

BUILT_FROM := $(wildcard $(foreach f,setup.py setup.cfg package.xml launch/* config/*,ros2_ws/src/*/$(f)))
ACTIVATE := . ./env.sh &&

.PHONY: help setup demo test test-all test-benchmark test-slow test-physx test-driver mutants driver-report hardware physx meshes foxglove lerobot cluster bench soak simtest fuzz blind blind-task evaluate table3 finetune train identify docs format lock clean distclean

help: ## this list
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: ros2_ws/install/.built ## .venv from requirements.lock, then colcon build

.venv/.installed: requirements.lock tools/install.sh tools/python.sh
	@tools/check.sh && tools/install.sh
	@touch $@

.venv/.ros2: .venv/.installed $(wildcard tools/ros2_lite/*.toml tools/ros2_lite/ros2_lite/*.py)
	@.venv/bin/python -m pip --disable-pip-version-check -qq install --no-deps --no-build-isolation ./tools/ros2_lite
	@touch $@

# Python files are linked, not copied: only new packages, entry points, launch files or settings need a build. colcon asks every
# prefix for a local_setup, and warns of .venv, which has none.
ros2_ws/install/.built: .venv/.ros2 $(BUILT_FROM)
	@tools/check.sh && $(ACTIVATE) cd ros2_ws && AMENT_PREFIX_PATH="$${AMENT_PREFIX_PATH//$$VIRTUAL_ENV}" colcon build --symlink-install --event-handlers console_cohesion- desktop_notification-
	@touch $@

demo: setup ## DOMAIN EPISODES SEED KEYPOINTS OBJECT: three episodes through the graph: bag, report, video
	@$(ACTIVATE) exec ros2 run np_evaluation demo --domain $(DOMAIN) --seed $(SEED) --keypoints $(KEYPOINTS) --object $(OBJECT) \
		$(if $(filter-out file,$(origin EPISODES)),--episodes $(EPISODES)) $(ARGS)

evaluate: $(if $(filter physx,$(ENGINE)),physx,setup) ## DOMAIN EPISODES SEED KEYPOINTS=camera|truth OBJECT EFFECTS ENGINE=mujoco|physx CONTACTS=1 JOBS=1 CLUSTER: success rate as JSON
	@$(ACTIVATE) exec ros2 run np_evaluation evaluate --engine $(ENGINE) --domain $(DOMAIN) --episodes $(EPISODES) --seed $(SEED) \
		--keypoints $(KEYPOINTS) --object $(OBJECT) --effects $(EFFECTS) \
		$(if $(CONTACTS),--contacts $(CONTACTS)) $(if $(filter-out file,$(origin JOBS)),--jobs $(JOBS)) $(ON) $(ARGS)

table3: $(if $(filter physx,$(ENGINE)),physx,setup) ## ENGINE KEYPOINTS SEED CONTACTS=1 JOBS CLUSTER ARGS="--tries 50": the paper's 21 objects in three scenarios, beside its own successes
	@$(ACTIVATE) exec ros2 run np_evaluation table3 --engine $(ENGINE) --keypoints $(KEYPOINTS) --seed $(SEED) --jobs $(JOBS) \
		$(if $(CONTACTS),--contacts $(CONTACTS)) $(ON) $(ARGS)

bench: setup ## latencies, real-time factor, planning time as JSON
	@$(ACTIVATE) exec ros2 run np_evaluation bench $(ARGS)

soak: setup ## DOMAIN EPISODES SEED ARGS="--hours 1": episodes in one graph, in lockstep, or hours in real time: memory, handles and threads stay flat, as JSON
	@$(ACTIVATE) exec python -m np_evaluation.commands.soak --domain $(DOMAIN) --seed $(SEED) \
		$(if $(filter-out file,$(origin EPISODES)),--episodes $(EPISODES)) $(ARGS)

simtest: setup ## SEEDS=20 ARGS="--one SEED": the nodes in one process under simulated faults; guarantees must hold; as JSON
	@$(ACTIVATE) export OMP_NUM_THREADS=1 MUJOCO_GL=disable; exec python -m np_evaluation.commands.simtest --seeds $(SEEDS) $(ARGS)

fuzz: setup ## SEED: random and malformed messages on every topic: none of the nodes dies, as JSON
	@$(ACTIVATE) exec python -m np_evaluation.commands.fuzz --seed $(SEED) $(ARGS)

blind: setup ## CASES SEED SET=[locked|development][_changes|_six] JOBS CLUSTER: the diagnosis of the arm on sealed cases, as JSON
	@$(ACTIVATE) exec python -m np_blind.arm.set --cases $(CASES) --seed $(SEED) --set $(SET) --jobs $(JOBS) \
		$(ON) $(ARGS)

blind-task: physx ## CASES=16 SEED=1 JOBS CLUSTER ARGS=--seal: the task diagnosis in PhysX on sealed cases, as JSON
	@$(ACTIVATE) exec python -m np_blind.task.set $(if $(filter-out file,$(origin CASES)),--cases $(CASES)) \
		$(if $(filter-out file,$(origin SEED)),--seed $(SEED)) --jobs $(JOBS) $(ON) $(ARGS)

finetune: $(if $(filter physx,$(ENGINE)),physx,setup) ## BAG="runs/suite_000 runs/task_000" DOMAIN EPISODES=100 OBJECT SEED JOBS ARGS="--minutes 5": from recordings to policies corrected or fine-tuned for the arm; a page
	@$(ACTIVATE) exec ros2 run np_evaluation finetune $(BAG) --domain $(DOMAIN) --object $(OBJECT) --seed $(SEED) --jobs $(JOBS) \
		$(if $(filter-out file,$(origin EPISODES)),--episodes $(EPISODES)) $(ARGS)

train: setup ## DOMAIN SEED GPUS: make its policies by recipes/DOMAIN.yaml, from nothing to judged weights; killed, it goes on
	@$(ACTIVATE) exec python -m $(if $(GPUS),torch.distributed.run --standalone --nproc-per-node $(GPUS) -m )np_training.train --recipe recipes/$(DOMAIN).yaml --seed $(SEED) --out runs/$(DOMAIN)_$(SEED) $(ARGS)

identify: setup ## BAG="run1 run2" | none: a simulated arm; friction, damping, armature and what they explain
	@$(ACTIVATE) exec python -m np_blind.baselines.identify $(or $(BAG),--simulate) --seed $(SEED) $(ARGS)

test: setup ## every test that needs no GPU; PYTEST_ARGS="tests/np_control -k name": only these
ifdef PYTEST_ARGS
	@$(ACTIVATE) exec python -m pytest $(PYTEST_ARGS)
else
	@$(ACTIVATE) ruff format --quiet --check . && ruff check --quiet .
	@$(ACTIVATE) exec tools/test.sh
endif

test-all: ## `make test`, then the tests of PhysX and of the driver on the wire, whose extras it installs
	@$(MAKE) --no-print-directory test
	@$(MAKE) --no-print-directory test-physx
	@$(MAKE) --no-print-directory test-driver

test-physx: physx ## the second engine and its backend
	@$(ACTIVATE) tools/test.sh -n 2 --dist loadfile -m "not slow and not real_time" tests/np_physx_bridge tests/contract -k physx $(PYTEST_ARGS)
	@$(ACTIVATE) exec tools/test.sh -m "real_time and not slow" tests/contract -k physx $(PYTEST_ARGS)

test-benchmark: setup ## the tests of the benchmark (benchmark/tests)
	@$(ACTIVATE) export OMP_NUM_THREADS=1 MUJOCO_GL=disable; exec python -m pytest -n 2 --dist loadfile benchmark/tests $(PYTEST_ARGS)

test-slow: setup ## the slowest tests, which say least beyond those of `make test`
	@$(ACTIVATE) export OMP_NUM_THREADS=1 MUJOCO_GL=disable; exec python -m pytest -n 2 --dist worksteal -m slow

mutants: setup ## CASES=200 SEED JOBS SET=control|learner|training: small faults in control or training; a test has to notice each, as JSON
	@$(ACTIVATE) export OMP_NUM_THREADS=1 MUJOCO_GL=disable; exec python tools/mutants.py \
		$(if $(filter-out file,$(origin SET)),--set $(SET)) --cases $(CASES) --seed $(SEED) --jobs $(JOBS) $(ARGS)

# What a robot's network protocol needs is installed only here: nobody else does.
.venv/.hardware: requirements-hardware.txt .venv/.installed
	@.venv/bin/python -m pip --disable-pip-version-check -qq install -r $<
	@touch $@

.venv-franka-sim/.installed: tests/driver/requirements.txt tools/python.sh
	@tools/check.sh && unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH PYTHONHOME && "$$(tools/python.sh)" -m venv --clear .venv-franka-sim \
		&& .venv-franka-sim/bin/python -m pip --disable-pip-version-check -qq install -r $<
	@touch $@

# Without dependencies: opencv-python, which SAPIEN asks for, would overwrite opencv-python-headless.
.venv/.physx: requirements-physx.txt .venv/.installed
	@.venv/bin/python -m pip --disable-pip-version-check -qq install --no-deps -r $<
	@touch $@

.venv/.lerobot: requirements-lerobot.txt .venv/.installed
	@.venv/bin/python -m pip --disable-pip-version-check -qq install -r $<
	@touch $@

.venv/.cluster: requirements-cluster.txt .venv/.installed
	@.venv/bin/python -m pip --disable-pip-version-check -qq install -r $<
	@touch $@

cluster: setup .venv/.cluster ## add Dask: make table3 CLUSTER=tcp://host:8786, docs/guide/train.md

physx: setup .venv/.physx ## add the second engine: make evaluate ENGINE=physx

# Without dependencies: of the first only its files are wanted.
.venv/.meshes: requirements-meshes.txt .venv/.installed
	@.venv/bin/python -m pip --disable-pip-version-check -qq install --no-deps -r $<
	@touch $@

meshes: setup .venv/.meshes ## add how the arm looks: pages, windows and videos draw it in place of the shapes that collide

.venv/.foxglove: requirements-foxglove.txt .venv/.installed
	@.venv/bin/python -m pip --disable-pip-version-check -qq install -r $<
	@touch $@

foxglove: setup .venv/.foxglove ## add the stream for the Foxglove app: ros2 run np_bringup view [BAG] --foxglove

lerobot: setup .venv/.lerobot ## add what LeRobot data sets need: ros2 run np_record export_lerobot BAG... --out DIR

hardware: setup .venv/.hardware ## add what the driver of a real arm needs: docs/guide/hardware.md

test-driver: hardware .venv-franka-sim/.installed ## the hardware driver against a simulated robot's network protocol
	@$(ACTIVATE) exec tools/test.sh tests/driver tests/camera tests/contract -k driver $(PYTEST_ARGS)

driver-report: hardware .venv-franka-sim/.installed ## measure the driver: faults, tracking, an approach; docs/results/driver.md
	@$(ACTIVATE) exec python tests/driver/report.py $(ARGS)

docs: setup ## write the pages of docs that follow from data or code: parameters, effects, report, results
	@$(ACTIVATE) exec python tools/docs.py

format: setup ## the one formatter and order of imports, applied
	@$(ACTIVATE) ruff check --quiet --select I --fix . && ruff format --quiet .

lock: setup ## resolve requirements.txt into requirements.lock
	@.venv/bin/python tools/lock.py > requirements.lock.new && mv requirements.lock.new requirements.lock

clean: ## remove what colcon built
	rm -rf ros2_ws/build ros2_ws/install ros2_ws/log

distclean: clean ## remove the virtual environment too
	rm -rf .venv .venv-franka-sim
