/** A file that one view hands to the next. */

let handed: File | null = null;

export function hand(file: File): void {
  handed = file;
}

/** Return the handed file once. */
export function take(): File | null {
  const file = handed;
  handed = null;
  return file;
}
