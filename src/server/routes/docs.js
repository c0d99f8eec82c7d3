// What the pages at /docs do otherwise than Swagger UI does by itself.
window.onload = () => {
  // Longer texts are offered as a file, with their beginning: a dance of 30 s is 1.3 MB of numbers,
  // which the page would lay out for minutes.
  const LONGEST_SHOWN = 50_000;
  const BEGINNING = 2_000;
  const isLong = (text) => typeof text === "string" && text.length > LONGEST_SHOWN;

  // The page offers the first type of each list; the document itself begins with what programs want.
  const FIRST = ["multipart/form-data", "application/x-bvh"];
  const ordered = (content) => {
    const types = Object.keys(content);
    const first = FIRST.filter((type) => types.includes(type));
    const rest = types.filter((type) => !first.includes(type));
    return Object.fromEntries([...first, ...rest].map((type) => [type, content[type]]));
  };
  const reorder = (spec) => {
    for (const path of Object.values(spec.paths ?? {})) {
      for (const operation of Object.values(path)) {
        const bodies = [operation.requestBody, ...Object.values(operation.responses ?? {})];
        for (const body of bodies.filter((body) => body?.content)) {
          body.content = ordered(body.content);
        }
      }
    }
    return spec;
  };

  const Bailando = (system) => ({
    statePlugins: {
      spec: {
        wrapActions: { updateJsonSpec: (original) => (spec) => original(reorder(spec)) },
      },
    },
    wrapComponents: {
      // Parts of a form that nobody filled in are not sent, whatever values would be possible.
      RequestBody: (Original) => (props) => {
        const sample = (schema, type, ...rest) =>
          type === false ? "" : props.fn.getSampleSchema(schema, type, ...rest);
        const fn = { ...props.fn, getSampleSchema: sample };
        return system.React.createElement(Original, { ...props, fn });
      },
      // No option may be empty.
      ParameterIncludeEmpty: () => () => null,
      responseBody: (Original) => (props) => {
        const create = system.React.createElement;
        if (!isLong(props.content)) return create(Original, props);
        const file = new Blob([props.content], { type: props.contentType });
        const link = create(
          "a",
          { href: URL.createObjectURL(file), download: "dance.json" },
          `Download file (${props.content.length.toLocaleString("en")} characters)`,
        );
        const beginning = `${props.content.slice(0, BEGINNING)} ..`;
        return create("div", null, link, create("pre", { className: "microlight" }, beginning));
      },
    },
  });

  window.ui = SwaggerUIBundle({
    url: "/api-doc/openapi.json",
    dom_id: "#swagger-ui",
    deepLinking: true,
    layout: "StandaloneLayout",
    presets: [SwaggerUIBundle.presets.apis, SwaggerUIStandalonePreset],
    plugins: [SwaggerUIBundle.plugins.DownloadUrl, Bailando],
    // The text is enough: the page would copy the numbers one by one.
    responseInterceptor: (response) => {
      if (isLong(response.text)) {
        delete response.obj;
        delete response.body;
      }
      return response;
    },
  });
};
