# The targets of everyday work. `make run` and `make test` need a Rust toolchain, a C linker and, for
# one download, python3 with pip; they say what is missing.

CARGO ?= cargo
# Arguments for the server: make run ARGS='--port 9000 --model-dir my-model'
ARGS ?=
# Seconds for each fuzz target, and which targets (default: all): make fuzz SECONDS=600 TARGETS=container
SECONDS ?= 60
TARGETS ?=
# Any engine with docker's `build` command line: docker, podman, buildah.
DOCKER ?= docker
IMAGE ?= bailando

# The linter compiles the tests: one pass over the code instead of two. Arguments as clippy has them.
LINTING := RUSTC_WORKSPACE_WRAPPER=clippy-driver \
	CLIPPY_ARGS=-D__CLIPPY_HACKERY__warnings__CLIPPY_HACKERY__

.DEFAULT_GOAL := help
.PHONY: help setup run build check test web web-test book fuzz fmt deny lint-deploy chaos soak clean docker toolchain

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## fetch the ONNX Runtime library (pinned and checksummed) into .onnxruntime/
	@if [ -n "$$ORT_DYLIB_PATH" ]; then echo "ORT_DYLIB_PATH is set: no library is fetched"; \
	else scripts/fetch-onnxruntime.sh; fi

toolchain:
	@scripts/check-toolchain.sh

run: toolchain setup ## build and start the server (ARGS='--port 9000 ..')
	$(CARGO) run --release --locked --bin bailando -- serve $(ARGS)

build: toolchain ## build both binaries, optimised, into target/release/
	$(CARGO) build --release --locked --workspace

check: setup ## format, lints, unit tests: for use while you work
	@scripts/check-toolchain.sh fmt clippy
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets --locked -- -D warnings
	@$(LINTING) scripts/test-summary.sh target/check.log \
		$(CARGO) test --workspace --lib --bins --test architecture --locked --no-fail-fast -- --show-output

test: setup ## format, lints, documentation, every test; ends with 'P passed, F failed, S skipped'
	@scripts/check-toolchain.sh fmt clippy
	$(CARGO) fmt --all --check
	$(LINTING) $(CARGO) test --workspace --all-targets --locked --no-run
	@$(LINTING) RUSTDOC='$(CURDIR)/scripts/rustdoc-checked.sh' scripts/test-summary.sh target/test.log \
		$(CARGO) test --workspace --locked --no-fail-fast -- --show-output

# What npm has installed, as it writes it down.
WEB_MODULES := web/node_modules/.package-lock.json

$(WEB_MODULES): web/package-lock.json
	@node --version >/dev/null 2>&1 || { echo "node is missing: 20.19 or newer, with npm" >&2; exit 1; }
	cd web && npm ci --no-audit --no-fund

web: $(WEB_MODULES) ## build the viewer of web/ into web/dist, which is committed (node, npm)
	cd web && npm run build

web-test: toolchain setup $(WEB_MODULES) ## test the viewer in a real browser (node, npm, chromium)
	$(CARGO) build --locked --bin bailando
	cd web && npm run check && npm test && npm run e2e

book: ## build the documentation as a book into target/book, and check its links (mdbook, python3)
	@scripts/build-book.sh

fuzz: ## fuzz every target for SECONDS=60 (needs a nightly compiler and cargo-fuzz)
	@scripts/fuzz.sh $(SECONDS) $(TARGETS)

fmt: ## format the code
	$(CARGO) fmt --all

deny: ## check licences, sources and advisories of the dependencies (needs cargo-deny)
	@$(CARGO) deny --version >/dev/null 2>&1 || \
		{ echo "cargo-deny is missing: cargo install cargo-deny --locked" >&2; exit 1; }
	$(CARGO) deny --locked check

lint-deploy: ## check Dockerfile, deploy/ and the workflows with offline tools (needs python3)
	@scripts/check-deploy.sh

chaos: setup build ## bad files, overload, slow clients, stops: tests/load/ (python3, hey; ARGS='--quick')
	python3 tests/load/chaos.py $(ARGS)

soak: setup build ## half an hour of everything, watching memory (ARGS='--minutes 60')
	python3 tests/load/soak.py $(ARGS)

clean: ## remove build outputs and the fetched library
	$(CARGO) clean
	rm -rf .onnxruntime fuzz/target

docker: ## build the container image (DOCKER=podman, IMAGE=name)
	$(DOCKER) build -t $(IMAGE) .
