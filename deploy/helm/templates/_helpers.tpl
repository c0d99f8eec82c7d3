{{- define "bailando.name" -}}
{{- if contains "bailando" .Release.Name }}{{ .Release.Name | trunc 50 | trimSuffix "-" }}
{{- else }}{{ printf "%s-bailando" .Release.Name | trunc 50 | trimSuffix "-" }}{{ end }}
{{- end }}

{{/* Labels that select the pods of a part: api or worker. */}}
{{- define "bailando.selector" -}}
app.kubernetes.io/name: bailando
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .part }}
{{- end }}

{{- define "bailando.labels" -}}
{{ include "bailando.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
helm.sh/chart: {{ .root.Chart.Name }}-{{ .root.Chart.Version }}
{{- end }}

{{/* What the settings contradict. */}}
{{- define "bailando.check" -}}
{{- if and .Values.database.secret (not .Values.storage.url) }}
{{- fail "database.secret needs storage.url: any server must find what another has stored" }}
{{- end }}
{{- if and .Values.storage.url (not .Values.database.secret) }}
{{- fail "storage.url needs database.secret: a PostgreSQL that all servers share" }}
{{- end }}
{{- if and .Values.worker.enabled (not .Values.database.secret) }}
{{- fail "worker.enabled needs database.secret and storage.url" }}
{{- end }}
{{- if and (eq .Values.api.role "api") (not .Values.worker.enabled) }}
{{- fail "api.role=api needs worker.enabled: somebody must do the work" }}
{{- end }}
{{- if and .Values.callbacks.allow (not .Values.callbacks.secret) }}
{{- fail "callbacks.allow needs callbacks.secret, which callbacks are signed with" }}
{{- end }}
{{- end }}

{{- define "bailando.environment" -}}
{{- $values := .root.Values -}}
- name: BAILANDO_JSON_OUTPUT
  value: "true"
- name: BAILANDO_SHUTDOWN_TIMEOUT
  value: {{ .own.shutdownSeconds | quote }}
- name: BAILANDO_ROLE
  value: {{ .role }}
{{- if $values.database.secret }}
- name: BAILANDO_DATABASE
  valueFrom:
    secretKeyRef:
      name: {{ $values.database.secret }}
      key: {{ $values.database.key }}
- name: BAILANDO_STORAGE
  value: {{ $values.storage.url | quote }}
- name: AWS_REGION
  value: {{ $values.storage.region | quote }}
{{- with $values.storage.endpoint }}
- name: AWS_ENDPOINT
  value: {{ . | quote }}
{{- if hasPrefix "http://" . }}
- name: AWS_ALLOW_HTTP
  value: "true"
{{- end }}
{{- end }}
{{- if $values.storage.secret }}
{{- range tuple "AWS_ACCESS_KEY_ID" "AWS_SECRET_ACCESS_KEY" }}
- name: {{ . }}
  valueFrom:
    secretKeyRef:
      name: {{ $values.storage.secret }}
      key: {{ . }}
{{- end }}
{{- end }}
{{- else }}
# The file system is read-only: jobs are kept in memory.
- name: BAILANDO_DATA_DIR
  value: none
{{- end }}
{{- if $values.apiKeys.secret }}
- name: BAILANDO_API_KEY_FILE
  value: /run/secrets/bailando/{{ $values.apiKeys.key }}
{{- end }}
{{- with $values.callbacks.allow }}
- name: BAILANDO_CALLBACK_ALLOW
  value: {{ join "," . | quote }}
- name: BAILANDO_CALLBACK_SECRET
  valueFrom:
    secretKeyRef:
      name: {{ $values.callbacks.secret }}
      key: {{ $values.callbacks.key }}
{{- end }}
{{- range $name, $value := $values.settings }}
- name: {{ $name }}
  value: {{ $value | quote }}
{{- end }}
{{- end }}

{{/* The pods of a part. */}}
{{- define "bailando.pods" -}}
{{- $values := .root.Values -}}
metadata:
  labels:
    {{- include "bailando.labels" . | nindent 4 }}
  {{- with $values.podAnnotations }}
  annotations:
    {{- toYaml . | nindent 4 }}
  {{- end }}
spec:
  serviceAccountName: {{ include "bailando.name" .root }}
  automountServiceAccountToken: false
  # A Service of this name would set BAILANDO_PORT to tcp://.., which the server would read as its own
  # setting.
  enableServiceLinks: false
  # Longer than the shutdown timeout. No preStop: on SIGTERM /ready is 503 at once, and the server keeps
  # listening while requests are under way.
  terminationGracePeriodSeconds: {{ add .own.shutdownSeconds 15 }}
  securityContext:
    runAsNonRoot: true
    {{- with $values.user }}
    runAsUser: {{ int . }}
    runAsGroup: {{ int . }}
    fsGroup: {{ int . }}
    {{- end }}
    seccompProfile:
      type: RuntimeDefault
  topologySpreadConstraints:
    - maxSkew: 1
      topologyKey: kubernetes.io/hostname
      whenUnsatisfiable: ScheduleAnyway
      labelSelector:
        matchLabels:
          {{- include "bailando.selector" . | nindent 10 }}
  {{- with $values.image.pullSecrets }}
  imagePullSecrets:
    {{- range . }}
    - name: {{ . }}
    {{- end }}
  {{- end }}
  containers:
    - name: bailando
      image: "{{ $values.image.repository }}:{{ coalesce .own.tag $values.image.tag .root.Chart.AppVersion }}"
      imagePullPolicy: {{ $values.image.pullPolicy }}
      ports:
        - name: http
          containerPort: 8080
      env:
        {{- include "bailando.environment" . | nindent 8 }}
      securityContext:
        allowPrivilegeEscalation: false
        readOnlyRootFilesystem: true
        capabilities:
          drop:
            - ALL
      # Loading a large model from a slow disk may take up to two minutes.
      startupProbe:
        httpGet:
          path: /ready
          port: http
        periodSeconds: 2
        timeoutSeconds: 2
        failureThreshold: 60
      readinessProbe:
        httpGet:
          path: /ready
          port: http
        periodSeconds: 5
        timeoutSeconds: 2
        failureThreshold: 2
      livenessProbe:
        httpGet:
          path: /health
          port: http
        periodSeconds: 10
        timeoutSeconds: 5
        failureThreshold: 6
      resources:
        {{- toYaml .own.resources | nindent 8 }}
      {{- if $values.apiKeys.secret }}
      volumeMounts:
        - name: api-keys
          mountPath: /run/secrets/bailando
          readOnly: true
      {{- end }}
  {{- if $values.apiKeys.secret }}
  volumes:
    - name: api-keys
      secret:
        secretName: {{ $values.apiKeys.secret }}
        # The group is fsGroup's, or the one that the cluster gives.
        defaultMode: 0440
  {{- end }}
  {{- with $values.nodeSelector }}
  nodeSelector:
    {{- toYaml . | nindent 4 }}
  {{- end }}
  {{- with $values.tolerations }}
  tolerations:
    {{- toYaml . | nindent 4 }}
  {{- end }}
  {{- with $values.affinity }}
  affinity:
    {{- toYaml . | nindent 4 }}
  {{- end }}
{{- end }}

{{/* Everything that a part has. */}}
{{- define "bailando.part" -}}
{{- $name := printf "%s-%s" (include "bailando.name" .root) .part -}}
apiVersion: apps/v1
kind: Deployment
metadata:
  name: {{ $name }}
  labels:
    {{- include "bailando.labels" . | nindent 4 }}
spec:
  {{- if not .own.autoscaling.enabled }}
  replicas: {{ .own.replicas }}
  {{- end }}
  revisionHistoryLimit: 3
  selector:
    matchLabels:
      {{- include "bailando.selector" . | nindent 6 }}
  strategy:
    type: RollingUpdate
    rollingUpdate:
      maxUnavailable: 0
      maxSurge: 1
  template:
    {{- include "bailando.pods" . | nindent 4 }}
---
apiVersion: policy/v1
kind: PodDisruptionBudget
metadata:
  name: {{ $name }}
  labels:
    {{- include "bailando.labels" . | nindent 4 }}
spec:
  maxUnavailable: {{ .root.Values.podDisruptionBudget.maxUnavailable }}
  # A server that is not ready serves nobody: it must not block the draining of its node.
  unhealthyPodEvictionPolicy: AlwaysAllow
  selector:
    matchLabels:
      {{- include "bailando.selector" . | nindent 6 }}
{{- end }}

{{/* Autoscaling of a part by processor time. */}}
{{- define "bailando.hpa" -}}
{{- $name := printf "%s-%s" (include "bailando.name" .root) .part -}}
apiVersion: autoscaling/v2
kind: HorizontalPodAutoscaler
metadata:
  name: {{ $name }}
  labels:
    {{- include "bailando.labels" . | nindent 4 }}
spec:
  scaleTargetRef:
    apiVersion: apps/v1
    kind: Deployment
    name: {{ $name }}
  minReplicas: {{ .own.autoscaling.min }}
  maxReplicas: {{ .own.autoscaling.max }}
  metrics:
    - type: Resource
      resource:
        name: cpu
        target:
          type: AverageValue
          averageValue: {{ .own.autoscaling.cpu }}
  behavior:
    scaleDown:
      # A server whose jobs are in memory loses its finished ones: not one after every quiet minute.
      stabilizationWindowSeconds: 600
      policies:
        - type: Pods
          value: 1
          periodSeconds: 120
{{- end }}
