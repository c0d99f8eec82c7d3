// Types of the API by openapi-typescript, with files as Blob, as its documentation says.
//
// usage: node types.mjs OPENAPI.json TYPES.ts
import { readFileSync, writeFileSync } from 'node:fs';
import openapiTypes, { astToString } from 'openapi-typescript';
import ts from 'typescript';

const [document, types] = process.argv.slice(2);
const blob = ts.factory.createTypeReferenceNode('Blob');
const tree = await openapiTypes(JSON.parse(readFileSync(document, 'utf8')), {
  transform: (schema) => (schema.format === 'binary' ? blob : undefined),
});
writeFileSync(types, astToString(tree));
